"""The equation types that can be chosen (dynamic, filtered, power, energy, base wrench), with their options."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.base_classes import EquationType


@dataclass(frozen=True)
class Power(EquationType):
    """Rows of the power model [12.51]."""

    name = "power"
    label = "power"
    words = (
        "One row per sample [12.51]: no interval to choose, and offsets do not accumulate; needs a more exciting "
        "motion."
    )
    brief = "energy rate"
    place = 4


@dataclass(frozen=True)
class Filtered(EquationType):
    """Rows of the filtered dynamic model [12.28], with `pole`."""

    name = "filtered"
    label = "filtered dynamic"
    words = "Like the dynamic model, but without accelerations [12.28]: for noisy encoders."
    brief = "without accelerations"
    place = 2
    by_joint = True


@dataclass(frozen=True)
class Energy(EquationType):
    """Rows of the energy model [12.43], with `interval`."""

    name = "energy"
    label = "energy"
    words = "One row per interval [12.43]: needs no accelerations or filters, but a more exciting motion."
    brief = "over intervals"
    place = 3


@dataclass(frozen=True)
class BaseWrench(EquationType):
    """Six rows from a force-torque sensor under the base."""

    name = "base_wrench"
    label = "base wrench"
    words = "Six rows per sample from a force-torque sensor under the base: joint friction does not appear in them."
    brief = "a force-torque sensor under the base"
    place = 5


@dataclass(frozen=True)
class Dynamic(EquationType):
    """Rows of the dynamic model [12.18]."""

    name = "dynamic"
    label = "dynamic"
    words = "One row per joint and sample [12.18]: shows the parameters best. The usual choice."
    brief = "joint torques"
    place = 1
    by_joint = True
