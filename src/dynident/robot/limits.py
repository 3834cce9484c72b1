"""Limits and drive chains of joints, as users state them beside a robot's description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import isclose
from typing import Any

from dynident.errors import DynidentError
from dynident.schema.fields import Request, declare_field, get_description

SMALLEST, LARGEST = 1e-6, 1e9
"""Range of limits in SI units: one below keeps a joint still, one above limits no machine."""
TITLE = "Unusable robot settings"


@dataclass(frozen=True)
class Limits(Request):
    """Limits of one joint, in either direction; None where none is known.

    Parameters
    ----------
    position : (float, float), optional
        Lowest and highest position, rad or m.
    velocity : float, optional
        Largest speed, rad/s or m/s.
    acceleration : float, optional
        Largest acceleration, rad/s² or m/s².
    jerk : float, optional
        Largest change of the acceleration, rad/s³ or m/s³.
    effort : float, optional
        Largest torque or force, N m or N.
    power : float, optional
        Largest product of torque and velocity, W.
    """

    position: tuple[float, float] | None = declare_field("Lowest and highest position", default=None, unit="rad or m")
    velocity: float | None = declare_field(
        "Largest speed", default=None, unit="rad/s or m/s", at_least=SMALLEST, at_most=LARGEST
    )
    acceleration: float | None = declare_field(
        "Largest acceleration", default=None, unit="rad/s² or m/s²", at_least=SMALLEST, at_most=LARGEST
    )
    jerk: float | None = declare_field(
        "Largest change of the acceleration", default=None, unit="rad/s³ or m/s³", at_least=SMALLEST, at_most=LARGEST
    )
    effort: float | None = declare_field(
        "Largest torque or force", default=None, unit="N m or N", at_least=SMALLEST, at_most=LARGEST
    )
    power: float | None = declare_field(
        "Largest product of torque and velocity", default=None, unit="W", at_least=SMALLEST, at_most=LARGEST
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.position is not None and not self.position[0] < self.position[1]:
            raise DynidentError(
                f"position is {list(self.position)}; give two numbers, the lower one first",
                pointer="/position",
                title=TITLE,
            )

    @property
    def known_values(self) -> dict[str, Any]:
        """The limits that are known, by name."""
        return {item.name: value for item in fields(self) if (value := getattr(self, item.name)) is not None}

    @classmethod
    def from_description(
        cls,
        position: tuple[float, float] | None = None,
        velocity: float | None = None,
        effort: float | None = None,
    ) -> Limits:
        """Build the limits that a description states.

        Some descriptions write huge numbers, or zero, where nothing is limited: these count as not known.

        Parameters
        ----------
        position : (float, float), optional
            Lowest and highest position, rad or m.
        velocity : float, optional
            Largest speed, rad/s or m/s.
        effort : float, optional
            Largest torque or force, N m or N.

        Returns
        -------
        Limits
            Those of the numbers that limit something.
        """
        described: dict[str, float | None] = {"velocity": velocity, "effort": effort}
        accepts = {item.name: get_description(item).accepts for item in fields(cls)}
        known = {name: value for name, value in described.items() if value is not None and accepts[name](value)}
        bounded = position is not None and all(accepts["position"](end) for end in position)
        return cls(position if bounded else None, **known)


@dataclass(frozen=True)
class Drive(Request):
    """The drive chain of one joint, [12.17]: joint torque = drive_gain x recorded current.

    The motor's speed is the gear ratio times (q̇ + Σ coupling q̇ of the other joint).

    Parameters
    ----------
    drive_gain : float, optional
        N m or N per unit of current; instead of it, its three factors may be stated.
    gear_ratio : float, optional
        Turns of the motor in one turn of the joint.
    torque_constant : float, optional
        Torque of the motor, N m per unit of current.
    amplifier_gain : float, optional
        Current per unit of the recorded signal; 1 by default.
    coupling : mapping of str to float
        Other joints that this motor turns with, and how far beside its own; its torque acts on them in the same shares.
    """

    drive_gain: float | None = declare_field(
        "Joint torque per unit of current",
        default=None,
        unit="N m or N",
        at_least=-LARGEST,
        at_most=LARGEST,
        nonzero=True,
    )
    gear_ratio: float | None = declare_field(
        "Turns of the motor per turn of the joint", default=None, at_least=-LARGEST, at_most=LARGEST, nonzero=True
    )
    torque_constant: float | None = declare_field(
        "Motor torque per unit of current", default=None, unit="N m", at_least=-LARGEST, at_most=LARGEST, nonzero=True
    )
    amplifier_gain: float | None = declare_field(
        "Current per unit of the recorded signal", default=None, at_least=-LARGEST, at_most=LARGEST, nonzero=True
    )
    coupling: Mapping[str, float] = declare_field(
        "Other joints that this motor also moves, each with its motion relative to the motor's own joint; the motor's "
        "torque acts on them with the same factors",
        made_by=dict,
        at_least=-LARGEST,
        at_most=LARGEST,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        factors = self._multiply_factors()
        # Rounded factors give nearly, not exactly, a rounded gain.
        if self.drive_gain is not None and factors is not None and not isclose(self.drive_gain, factors, rel_tol=1e-3):
            raise DynidentError(
                f"drive_gain is {self.drive_gain}, but gear ratio, torque constant and amplifier gain give "
                f"{factors:g} [12.17]; give only one of the two",
                pointer="/drive_gain",
                title=TITLE,
            )

    @property
    def gain(self) -> float | None:
        """G_T = N K_a K_T of [12.17b] in N m per unit of current; None while a factor is missing."""
        return self._multiply_factors() if self.drive_gain is None else self.drive_gain

    def _multiply_factors(self) -> float | None:
        if self.gear_ratio is None or self.torque_constant is None:
            return None
        return self.gear_ratio * self.torque_constant * (1.0 if self.amplifier_gain is None else self.amplifier_gain)
