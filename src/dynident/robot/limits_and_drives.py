"""Limits and drive chains of joints that users state beside the description; parts of a closed machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import isclose
from types import MappingProxyType

from dynident.errors import DynidentError
from dynident.schema.fields import Request, declare_field, get_description

SMALLEST, LARGEST = 1e-6, 1e9
"""Range of limits in SI units: one below keeps a joint still, one above limits no machine."""
TITLE = "Unusable robot settings"
HARDWARE: Mapping[str, str] = MappingProxyType(
    {
        "gravity_compensator": "a gravity compensating spring or balancer",
        "spring": "a spring, cable or hose that pulls a joint to a rest position",
        "cable": "a cable, hose or spring between two links",
        "coupled_wrist": "a gear, belt or cable that couples two motors, as in many wrists",
    }
)
"""Parts that only some robots have: the names that `has` and `has_not` of a robot take, and what they mean."""


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

    def override(self, others: Limits) -> Limits:
        """Return these limits, and those of others where none is known here.

        Parameters
        ----------
        others : Limits
            Limits of the same joint.

        Returns
        -------
        Limits
            None where neither knows a limit.
        """
        known = {item.name: value for item in fields(self) if (value := getattr(self, item.name)) is not None}
        return replace(others, **known)

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
        "Joint torque per unit of current, or of a position servo per rad (or m) between command and position",
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


def split_hardware(hardware: Mapping[str, bool]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the parts that a robot has, and those that it has not.

    Parameters
    ----------
    hardware : mapping of str to bool
        Whether the robot has a part, by its name of `HARDWARE`.

    Raises
    ------
    DynidentError
        For a part of another name.
    """
    has = tuple(name for name, is_there in hardware.items() if is_there)
    has_not = tuple(name for name, is_there in hardware.items() if not is_there)
    check_hardware(has, has_not)
    return has, has_not


def check_hardware(has: Sequence[str], has_not: Sequence[str]) -> None:
    """Raise an error for a part that is none of `HARDWARE`, or that the robot both has and has not.

    Parameters
    ----------
    has, has_not : sequence of str
        Parts that the robot has, and parts that it does not have.

    Raises
    ------
    DynidentError
        With the pointer to the name.
    """
    for part, names in (("has", has), ("has_not", has_not)):
        for index, name in enumerate(names):
            if name not in HARDWARE:
                known = "; ".join(f"{word} ({meaning})" for word, meaning in HARDWARE.items())
                raise DynidentError(
                    f"There is no hardware '{name}'; the names are: {known}.", pointer=f"/{part}/{index}", title=TITLE
                )
            if part == "has_not" and name in has:
                raise DynidentError(
                    f"'{name}' is in has and in has_not; name it in one of the two.",
                    pointer=f"/{part}/{index}",
                    title=TITLE,
                )
