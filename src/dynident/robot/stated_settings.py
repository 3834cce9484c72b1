"""Settings that a user states beside the description: limits, drives, locked joints, gravity (default -9.81 m/s²)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError, describe_missing_joint
from dynident.robot.json_fields import join_names, make_pointer
from dynident.robot.limits_and_drives import TITLE, Drive, Limits

GRAVITY = (0.0, 0.0, -9.81)
"""Gravity in the base frame where nobody states another (m/s²)."""


@dataclass(frozen=True)
class Settings:
    """Settings that override or complete a description.

    Parameters
    ----------
    limits : mapping of str to Limits
        By joint.
    drives : mapping of str to Drive
        Drive chains by joint.
    locked_joints : mapping of str to float
        Positions (rad, m) to lock joints at, by name.
    gravity : (3,)
        Acceleration of gravity in the base frame, m/s².
    """

    limits: Mapping[str, Limits] = field(default_factory=dict)
    drives: Mapping[str, Drive] = field(default_factory=dict)
    locked_joints: Mapping[str, float] = field(default_factory=dict)
    gravity: FloatArray = field(default_factory=lambda: np.array(GRAVITY))


def build_settings(
    limits: Mapping[str, Limits] | None,
    drives: Mapping[str, Drive] | None,
    locked_joints: Mapping[str, float] | None,
    gravity: Sequence[float] | None,
) -> Settings:
    """Return checked settings with the defaults filled in.

    Names are checked by `check_names` once the joints are known.

    Parameters
    ----------
    limits : mapping of str to Limits or None
        By joint.
    drives : mapping of str to Drive or None
        Drive chains by joint.
    locked_joints : mapping of str to float or None
        Positions (rad, m) to lock joints at, by name.
    gravity : sequence of float or None
        Acceleration of gravity in the base frame (m/s²); (0, 0, -9.81) where it is None.

    Returns
    -------
    Settings
        The same, checked.

    Raises
    ------
    DynidentError
        With the pointer to a value that cannot be used.
    """
    for name, value in (locked_joints or {}).items():
        if not math.isfinite(value):
            raise _make_error(
                f"Joint '{name}' is locked at {value}; expected a number (rad or m).", "locked_joints", name
            )
    return Settings(
        limits or {}, drives or {}, locked_joints or {}, check_gravity(GRAVITY if gravity is None else gravity)
    )


def check_gravity(gravity: Sequence[float]) -> FloatArray:
    """Return the acceleration of gravity; zero is allowed (weightlessness).

    Parameters
    ----------
    gravity : sequence of float
        Its three components in the base frame, m/s².

    Returns
    -------
    (3,) array
        m/s².

    Raises
    ------
    DynidentError
        For anything but three finite numbers.
    """
    vector = np.asarray(gravity, dtype=float)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise DynidentError(
            f"Gravity is {list(gravity)}; expected three numbers in m/s².", pointer="/gravity", title=TITLE
        )
    return vector


def merge_limits(described: Limits, stated: Limits | None) -> Limits:
    """Return the stated limits, completed by those of the description.

    Parameters
    ----------
    described : Limits
        Limits of the description.
    stated : Limits or None
        Limits that the user states; they win, field by field.

    Returns
    -------
    Limits
        None where neither knows a limit.
    """
    return described if stated is None else stated.override(described)


def check_names(settings: Settings, moving: Sequence[str], fixed: Sequence[str] = ()) -> None:
    """Raise an error if a setting names a joint that does not exist, is fixed, or is locked as well.

    Parameters
    ----------
    settings : Settings
        What the user states.
    moving : sequence of str
        Names of the joints that move, locked ones included.
    fixed : sequence of str
        Names of the fixed joints.

    Raises
    ------
    DynidentError
        With the pointer to the setting.
    """
    moving_names = set(moving)
    for part in ("locked_joints", "limits", "drives"):
        for name in getattr(settings, part):
            if name in fixed:
                raise _make_error(f"Joint '{name}' is fixed in the description; leave it out.", part, name)
            if name not in moving_names:
                raise _make_error(describe_missing_joint(name, moving), part, name)
            if part == "drives" and name in settings.locked_joints:
                raise _make_error(f"Joint '{name}' is locked, so it cannot have a drive.", part, name)
    for joint, drive in settings.drives.items():
        for name in drive.coupling:
            if name == joint or name not in moving_names or name in settings.locked_joints:
                others = [other for other in moving if other != joint and other not in settings.locked_joints]
                raise _make_error(
                    f"The motor of joint '{joint}' cannot be coupled to '{name}'; others: {join_names(others)}.",
                    "drives",
                    joint,
                    "coupling",
                    name,
                )
    if moving and moving_names <= set(settings.locked_joints):
        raise _make_error("Every joint is locked; a robot needs at least one moving joint.", "locked_joints")


def _make_error(detail: str, *where: str) -> DynidentError:
    return DynidentError(detail, pointer=make_pointer(*where), title=TITLE)
