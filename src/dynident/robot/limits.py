"""Limits and drive chains of joints, as users state them beside a robot's description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynident.schema.fields import declare_field

SMALLEST, LARGEST = 1e-6, 1e9
"""Range of limits in SI units: one below keeps a joint still, one above limits no machine."""


@dataclass(frozen=True)
class Limits:
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

    position: tuple[float, float] | None = declare_field("Lowest and highest position, rad or m", default=None)
    velocity: float | None = declare_field("rad/s or m/s", default=None, at_least=SMALLEST, at_most=LARGEST)
    acceleration: float | None = declare_field("rad/s² or m/s²", default=None, at_least=SMALLEST, at_most=LARGEST)
    jerk: float | None = declare_field("rad/s³ or m/s³", default=None, at_least=SMALLEST, at_most=LARGEST)
    effort: float | None = declare_field("N m or N", default=None, at_least=SMALLEST, at_most=LARGEST)
    power: float | None = declare_field(
        "Limit of torque times velocity", default=None, unit="W", at_least=SMALLEST, at_most=LARGEST
    )


@dataclass(frozen=True)
class Drive:
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

    drive_gain: float | None = declare_field("N m or N per unit of current", default=None)
    gear_ratio: float | None = declare_field("Turns of the motor per turn of the joint", default=None)
    torque_constant: float | None = declare_field("Motor torque per unit of current, N m", default=None)
    amplifier_gain: float | None = declare_field("Current per unit of the recorded signal", default=None)
    coupling: Mapping[str, float] = declare_field(
        "Other joints that this motor also moves, each with its motion relative to the motor's own joint; the motor's "
        "torque acts on them with the same factors",
        made_by=dict,
    )

    @property
    def gain(self) -> float | None:
        """G_T = N K_a K_T of [12.17b] in N m per unit of current; None while a factor is missing."""
        if self.drive_gain is not None:
            return self.drive_gain
        if self.gear_ratio is None or self.torque_constant is None:
            return None
        return self.gear_ratio * self.torque_constant * (1.0 if self.amplifier_gain is None else self.amplifier_gain)
