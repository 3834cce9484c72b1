"""Limits and drive chains of joints, as users state them beside a robot's description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynident.schema.fields import declare_field

SMALLEST, LARGEST = 1e-6, 1e9
"""Range of limits in SI units: one below keeps a joint still, one above limits no machine."""


@dataclass(frozen=True)
class Limits:
    """Limits of one joint: rad or m, rad/s or m/s, …, N m or N, and W; None where none is known."""

    position: tuple[float, float] | None = declare_field("Lowest and highest, rad or m", default=None)
    velocity: float | None = declare_field("rad/s or m/s", default=None, at_least=SMALLEST, at_most=LARGEST)
    acceleration: float | None = declare_field("rad/s² or m/s²", default=None, at_least=SMALLEST, at_most=LARGEST)
    jerk: float | None = declare_field("rad/s³ or m/s³", default=None, at_least=SMALLEST, at_most=LARGEST)
    effort: float | None = declare_field("N m or N", default=None, at_least=SMALLEST, at_most=LARGEST)
    power: float | None = declare_field(
        "Of torque times velocity", default=None, unit="W", at_least=SMALLEST, at_most=LARGEST
    )


@dataclass(frozen=True)
class Drive:
    """The drive chain of one joint, [12.17]: joint torque = drive_gain x recorded current.

    The motor's speed is the gear ratio times (q̇ + Σ coupling q̇ of the other joint).
    """

    drive_gain: float | None = declare_field("N m or N per unit of current", default=None)
    gear_ratio: float | None = declare_field("Turns of the motor in one of the joint", default=None)
    torque_constant: float | None = declare_field("N m per unit of current, of the motor", default=None)
    amplifier_gain: float | None = declare_field("Unit of current per unit of what is recorded", default=None)
    coupling: Mapping[str, float] = declare_field(
        "Other joints that this motor turns with, and how far beside its own; its torque acts on them in the same "
        "shares",
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
