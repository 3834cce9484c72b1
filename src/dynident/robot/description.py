"""Read a robot from a description in any of the supported formats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from dynident.descriptions import FORMATS, DescriptionFormat
from dynident.errors import DynidentError
from dynident.robot.dh_text import robot_from_dh_text
from dynident.robot.mjcf import robot_from_mjcf
from dynident.robot.model import Description, Robot
from dynident.robot.modified_dh import robot_from_modified_dh
from dynident.robot.pointers import join_names
from dynident.robot.stated import Drive, Limits
from dynident.robot.urdf import robot_from_urdf

_POINTER = "/description/content"


class _Reader(Protocol):
    def __call__(
        self,
        name: str,
        content: str,
        /,
        *,
        limits: Mapping[str, Limits] | None,
        drives: Mapping[str, Drive] | None,
        locked_joints: Mapping[str, float] | None,
        gravity: Sequence[float] | None,
        pointer: str,
    ) -> Robot: ...


_READERS: dict[DescriptionFormat, _Reader] = {
    "urdf": robot_from_urdf,
    "modified_dh": robot_from_modified_dh,
    "mjcf": robot_from_mjcf,
    "dh": robot_from_dh_text,
}


def robot_from_description(
    name: str,
    description: Description,
    *,
    limits: Mapping[str, Limits] | None = None,
    drives: Mapping[str, Drive] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
) -> Robot:
    """Return the robot of a description, with settings that override or complete it.

    Parameters
    ----------
    name : str
        Name of the robot.
    description : Description
        A URDF, an MJCF model, a modified Denavit-Hartenberg table as JSON text (`dynident.robot.modified_dh`), or a
        classical or modified one pasted as text ("dh", `dynident.robot.dh_text`).
    limits, drives : mapping of joint name
        Limits win over the description's, field by field. Drive chains [12.17].
    locked_joints : mapping of joint name to position (rad or m)
        These joints no longer move; their links become part of the link before.
    gravity : (x, y, z), optional
        Acceleration of gravity in the base frame (m/s²); else the description's, else (0, 0, -9.81).

    Returns
    -------
    Robot

    Raises
    ------
    DynidentError
        Its pointer says where: "/description/content/…", "/limits/<joint>/position", "/locked_joints/<joint>", ….
    """
    reader = _READERS.get(description.format)
    if reader is None:
        raise DynidentError(
            f"Unknown format '{description.format}'; expected {join_names(FORMATS.names)}.",
            pointer="/description/format",
            title="Unusable robot description",
        )
    return reader(
        name,
        description.content,
        limits=limits,
        drives=drives,
        locked_joints=locked_joints,
        gravity=gravity,
        pointer=_POINTER,
    )
