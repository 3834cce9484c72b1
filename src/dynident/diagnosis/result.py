"""Result types of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice

Adequacy = Literal["adequate", "missing_effect", "unexplained"]
Variable = Literal["position", "velocity", "acceleration", "load", "time", "other_joints"]


@dataclass(frozen=True)
class RankedEffect:
    """One family at its best place and shape: `choice`, as it can be added.

    Errors are relative, held out, on its joints.
    """

    rank: int
    choice: EffectChoice
    error_before: float
    error_after: float
    error_drop: float
    t_value: float
    p_value: float
    significant: bool
    evidence: str
    equivalent: tuple[str, ...]
    separability: float

    @property
    def effect(self) -> str:
        """Id of the effect in the catalogue."""
        return self.choice.effect

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of its joints; none where it belongs to the whole robot."""
        return self.choice.joints


@dataclass(frozen=True)
class ChangedValue:
    """A number that is another one since: `value` is the difference, in `interval` with a probability of 95 %.

    `before`: what it was, where the model has it.
    """

    parameter: str
    value: float
    unit: str
    interval: tuple[float, float]
    before: float | None = None


@dataclass(frozen=True)
class Change:
    """What the later recordings have and the earlier ones have not: `choice`, in its runs, on one joint or the robot.

    `main` is the number that says how large it is, `more` the others; `p_value` that of the test among all that was
    tried; `equivalent`: effects, or joints where it is the same effect, that the data cannot tell from it.
    """

    choice: EffectChoice
    main: ChangedValue
    more: tuple[ChangedValue, ...]
    p_value: float
    evidence: str
    equivalent: tuple[str, ...] = ()


@dataclass(frozen=True)
class FrictionDifference:
    """How much more of a joint's torque goes into friction in the later recordings, a finding or not.

    At the joint's mean `speed` there, in rad/s or m/s: `value` in `unit` (N m or N), in `interval` with a probability
    of 95 %; `before`: what it would have been, on average there, without the difference.
    """

    joint: str
    speed: float
    value: float
    interval: tuple[float, float]
    unit: str
    before: float


@dataclass(frozen=True)
class UnknownPattern:
    """A dependence of a joint's residual that no effect of the catalogue explains; `share` of its variance."""

    joint: str
    variable: Variable
    share: float


@dataclass(frozen=True)
class Invisible:
    """An effect that this data could not have shown; `brief` says why where many stand beside each other."""

    effect: str
    joints: tuple[str, ...]
    reason: str
    brief: str = ""


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


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict on a model, what is missing in it, and what the data could not tell.

    Parameters
    ----------
    verdict : {"adequate", "missing_effect", "unexplained"}
        Whether the model is adequate, lacks an effect, or leaves a residual that no effect explains.
    summary : str
        The result in a few sentences.
    noise_floor : (n,)
        What no model of a joint can explain, N m or N, from the torque above the filter's band.
    residual_rms : (n,)
        Root mean square of the residual of each joint, N m or N.
    candidates : tuple of RankedEffect
        Effects that were tried, the one that explains most first.
    recommended : tuple of EffectChoice
        Effects to be added to the model.
    unknown : tuple of UnknownPattern
        Dependences in the residual that no effect explains.
    not_visible : tuple of Invisible
        Effects that this data could not have shown.
    failure_map : tuple of FailureSpot
        Where the residual of each joint is largest.
    changes : tuple of Change, optional
        What differs from the baseline, empty where nothing does; None where there was no baseline.
    friction : tuple of FrictionDifference
        How much the friction of each joint differs from the baseline's, whether it is among the changes or not.
    """

    verdict: Adequacy
    summary: str
    noise_floor: FloatArray
    residual_rms: FloatArray
    candidates: tuple[RankedEffect, ...]
    recommended: tuple[EffectChoice, ...]
    unknown: tuple[UnknownPattern, ...]
    not_visible: tuple[Invisible, ...]
    failure_map: tuple[FailureSpot, ...]
    changes: tuple[Change, ...] | None = None
    friction: tuple[FrictionDifference, ...] = ()

    def __repr__(self) -> str:
        since = "" if self.changes is None else f", {len(self.changes)} changes"
        return f"Diagnosis({self.verdict}{since}: {self.summary})"
