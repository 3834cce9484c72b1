"""What a diagnosis says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dynident.effects import EffectChoice
from dynident.robot.model import FloatArray

Verdict = Literal["adequate", "missing_effect", "unexplained"]
Variable = Literal["position", "velocity", "acceleration", "load", "time", "other_joints"]


@dataclass(frozen=True)
class RankedEffect:
    """One family at its best place and shape. Errors are relative, held out, on the joints named."""

    rank: int
    effect: str
    joints: tuple[str, ...]
    error_before: float
    error_after: float
    error_drop: float
    t_value: float
    p_value: float
    significant: bool
    evidence: str
    equivalent: tuple[str, ...]
    separability: float
    shape: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class UnknownPattern:
    """A dependence of a joint's residual that no effect of the catalogue explains; `share` of its variance."""

    joint: str
    variable: Variable
    share: float


@dataclass(frozen=True)
class Invisible:
    """An effect that this data could not have shown."""

    effect: str
    joints: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class FailureSpot:
    """Where a joint's residual is largest over one variable: `rms` (N m or N) between `low` and `high` of it."""

    joint: str
    variable: str
    unit: str
    low: float
    high: float
    rms: float
    ratio: float


@dataclass(frozen=True)
class NextExperiment:
    """A motion that would tell more: why, and the kind, joints and duration of the design."""

    reason: str
    kind: Literal["optimized", "constant_velocity"]
    effects: tuple[EffectChoice, ...]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict on a model, what is missing in it, and what the data could not tell.

    `noise_floor` (n,) in N m or N: what no model can explain, from the torque above the filter's band.
    """

    verdict: Verdict
    summary: str
    noise_floor: FloatArray
    residual_rms: FloatArray
    candidates: tuple[RankedEffect, ...]
    recommended: tuple[EffectChoice, ...]
    unknown: tuple[UnknownPattern, ...]
    not_visible: tuple[Invisible, ...]
    failure_map: tuple[FailureSpot, ...]
    next_experiment: NextExperiment | None
