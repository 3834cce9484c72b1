"""Result types of a diagnosis: ranked effects, changes, detection limits, conclusion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from dynident.array_types import FloatArray
from dynident.diagnosis.outcome_reasons import CandidateOutcome, Reason, find_outcome
from dynident.effects import EffectChoice, get_effect
from dynident.errors import DynidentError, KnownNames, describe_missing_joint

Adequacy = Literal["adequate", "missing_effect", "unexplained", "cannot_tell"]
Variable = Literal["position", "velocity", "acceleration", "load", "time", "other_joints"]


def word_title(effect: str, question: str) -> str:
    """Word an effect: what the data show, as long as a question is open whether the robot has such a part."""
    own = get_effect(effect)
    # Data never show a part of the robot: only a torque that such a part would give.
    return f"{own.appearance} ({own.title.lower()}?)" if question else own.title


@dataclass(frozen=True)
class RankedEffect(KnownNames):
    """An effect in the ranking of a diagnosis, at its best place.

    Parameters
    ----------
    rank : int
        Place in the ranking, from 1 on.
    choice : EffectChoice
        The effect at its best place with its best shape constants, as it can be added to a model.
    error_before : float
        Relative error without it, beside the model and the findings that were taken before it, on blocks of time of the
        diagnosed recordings that were left out of the fit in turn (cross-validation). It is that of the joints that the
        effect acts on, so that effects on different joints do not continue each other's errors.
    error_after : float
        The same error with it.
    error_drop : float
        Share of the error that it removes beside all that ranks above it: what it explains.
    t_value : float
        The t of its gain over the blocks of time.
    p_value : float
        The p-value of the test among all that was tried.
    significant : bool
        Whether it is a finding.
    evidence : str
        What speaks for it, in words.
    equivalent : tuple of str
        Ids of effects that the data cannot tell from it.
    separability : float
        Share of its column that is left beside the model, 0 to 1.
    reason : Reason, optional
        Why it is a finding or not; None in a diagnosis of an earlier version.
    question : str
        What to ask the robot's owner: whether it has the part that the effect is of. Empty where that is known, or
        the effect is of no such part.
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
    reason: Reason | None = None
    question: str = ""

    @property
    def title(self) -> str:
        """The effect in words: what the data show, as long as nobody has said that the robot has such a part."""
        return word_title(self.effect, self.question)

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
    """A parameter that differs in the later recordings.

    Parameters
    ----------
    parameter : str
        Name of the parameter.
    value : float
        Difference from the earlier recordings.
    unit : str
        Unit of the value.
    interval : tuple of (float, float)
        95 % interval of the difference.
    before : float, optional
        What it was before, where the model has it.
    """

    parameter: str
    value: float
    unit: str
    interval: tuple[float, float]
    before: float | None = None


@dataclass(frozen=True)
class Change:
    """An effect that the later recordings have and the earlier ones have not.

    Parameters
    ----------
    choice : EffectChoice
        The effect, in the later runs, on one joint or the robot.
    main : ChangedValue
        The parameter that says how large the change is.
    more : tuple of ChangedValue
        The other parameters.
    p_value : float
        The p-value of the test among all that was tried.
    evidence : str
        What speaks for it, in words.
    equivalent : tuple of str
        Ids of effects, or names of joints where it is the same effect, that the data cannot tell from it.
    carrier : str
        Name of the link that it is on, where that is the floating base, which no joint moves; else empty.
    """

    choice: EffectChoice
    main: ChangedValue
    more: tuple[ChangedValue, ...]
    p_value: float
    evidence: str
    equivalent: tuple[str, ...] = ()
    carrier: str = ""


@dataclass(frozen=True)
class FrictionDifference:
    """Difference of a joint's friction in the later recordings, whether it is a finding or not.

    Parameters
    ----------
    joint : str
        Name of the joint.
    speed : float
        Mean speed of the joint in the later recordings, rad/s or m/s.
    value : float
        How much larger the friction is at that speed.
    interval : tuple of (float, float)
        95 % interval of the value.
    unit : str
        Unit of the value, N m or N.
    before : float
        Mean friction without the difference.
    """

    joint: str
    speed: float
    value: float
    interval: tuple[float, float]
    unit: str
    before: float


@dataclass(frozen=True)
class UnknownPattern:
    """A dependence of a joint's residual that no effect of the catalogue explains.

    Parameters
    ----------
    joint : str
        Name of the joint.
    variable : Variable
        What the residual depends on.
    share : float
        Share of the residual's variance.
    cause : str, optional
        What no effect stands for and looks like this, in a sentence with what to do: a sensor that drifts, a coupled
        drive; "" where nothing says so.
    """

    joint: str
    variable: Variable
    share: float
    cause: str = ""


@dataclass(frozen=True)
class Invisible:
    """An effect that these data could not have shown.

    Parameters
    ----------
    effect : str
        Id of the effect.
    joints : tuple of str
        Names of the joints.
    reason : str
        Why it could not have shown, in a sentence.
    brief : str
        The same in a few words, for a table.
    """

    effect: str
    joints: tuple[str, ...]
    reason: str
    brief: str = ""


@dataclass(frozen=True)
class DetectionLimit:
    """The size of an effect on a joint that these recordings would have shown.

    Parameters
    ----------
    effect : str
        Id of the effect.
    joints : tuple of str
        Name of its joint; none where it belongs to the whole robot.
    parameter : str
        The parameter that tells how large it is: of several the one that is usually largest.
    unit : str
        Unit of the sizes.
    size : float
        Smallest size that the diagnosis would have accepted with a probability of 95 %; infinite where it would have
        accepted none.
    half_size : float
        The same with a probability of a half.
    usual : float
        Size of the parameter on arms that have the effect.
    shape : tuple of (str, float)
        Shape constants that the sizes are of: of those that the filtered position resolves the nearest to the usual.
    """

    effect: str
    joints: tuple[str, ...]
    parameter: str
    unit: str
    size: float
    half_size: float
    usual: float
    shape: tuple[tuple[str, float], ...] = ()

    @property
    def share(self) -> float:
        """The size over the usual size."""
        return self.size / self.usual


ConclusionCode = Literal["something_is_missing", "nothing_above_limits", "cannot_tell"]

NextAction = Literal["extend", "add_own_effect", "validate", "record"]
"""What comes next: add effects, look for one that the catalogue lacks, test the model, record another motion."""

_CONCLUSIONS: Mapping[ConclusionCode, str] = MappingProxyType(
    {
        "something_is_missing": "Something is missing.",
        "nothing_above_limits": "Nothing above the detection limits is missing.",
        "cannot_tell": "These data cannot tell whether something is missing.",
    }
)


@dataclass(frozen=True)
class Conclusion:
    """What a diagnosis says in all, and the one next thing to do.

    Parameters
    ----------
    code : {"something_is_missing", "nothing_above_limits", "cannot_tell"}
        What it says. "cannot_tell": errors on held-out data are far above those of the fit, or the detection limits are
        above the usual sizes of most effects that arms often have, or were not computed.
    why : tuple of str
        What the conclusion rests on, in sentences.
    next_step : str
        The next thing to do.
    next_action : {"extend", "add_own_effect", "validate", "record"}, optional
        The same as a code; None in a diagnosis of an earlier version, and where detection limits are to be computed.
    """

    code: ConclusionCode
    why: tuple[str, ...]
    next_step: str
    next_action: NextAction | None = None

    @property
    def headline(self) -> str:
        """The conclusion in a sentence."""
        return _CONCLUSIONS[self.code]

    def __str__(self) -> str:
        return " ".join((self.headline, *self.why, self.next_step))


@dataclass(frozen=True)
class FailureSpot:
    """The bin of a variable in which a joint's residual is largest.

    Parameters
    ----------
    joint : str
        Name of the joint.
    variable : str
        The variable: position, velocity, load or time.
    unit : str
        Unit of the variable.
    low : float
        Lower end of the bin.
    high : float
        Upper end of the bin.
    rms : float
        Rms of the residual in it, N m or N.
    ratio : float
        Ratio of that to the joint's rms over all rows.
    """

    joint: str
    variable: str
    unit: str
    low: float
    high: float
    rms: float
    ratio: float


@dataclass(frozen=True, eq=False)
class Diagnosis(KnownNames):
    """The verdict on a model, what is missing in it, and what the data could not tell.

    Parameters
    ----------
    verdict : {"adequate", "missing_effect", "unexplained", "cannot_tell"}
        Whether the model is adequate, lacks an effect, or leaves a residual that no effect explains, or whether the
        data do not tell.
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
        Effects that these data could not have shown.
    failure_map : tuple of FailureSpot
        Where the residual of each joint is largest.
    changes : tuple of Change, optional
        What differs from the baseline, empty where nothing does; None where there was no baseline.
    friction : tuple of FrictionDifference
        How much the friction of each joint differs from the baseline's, whether it is among the changes or not.
    outcomes : tuple of CandidateOutcome
        What became of every effect on every joint, and why.
    detection_limits : tuple of DetectionLimit
        The smallest size of each effect on each joint that these recordings would have shown; where there was a
        baseline, only of effects that arms often have.
    conclusion : Conclusion, optional
        What all this says, and the next thing to do; None in a diagnosis of an earlier version.
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
    outcomes: tuple[CandidateOutcome, ...] = ()
    detection_limits: tuple[DetectionLimit, ...] = ()
    conclusion: Conclusion | None = None

    @property
    def questions(self) -> tuple[str, ...]:
        """Questions to the robot's owner: whether it has the parts that recommended effects are of."""
        return tuple(dict.fromkeys(item.question for item in self.candidates if item.question))

    def get_title(self, choice: EffectChoice) -> str:
        """Return a recommended effect in words, as `RankedEffect.title`."""
        return (
            get_effect(choice.effect).title
            if not self.find_question(choice)
            else next(item.title for item in self.candidates if item.choice == choice)
        )

    def find_question(self, choice: EffectChoice) -> str:
        """Return the question that a recommended effect depends on; empty where there is none."""
        return next((item.question for item in self.candidates if item.choice == choice), "")

    def why_not(self, effect: str, joint: str = "") -> Reason:
        """Return why an effect on a joint is a finding or not.

        Parameters
        ----------
        effect : str
            Id of the effect, or with its joint as for `Model.extend`: "stribeck@elbow".
        joint : str
            Name of the joint; without it, the reason is that of the place where the effect explains most.

        Returns
        -------
        Reason
            Code, values, and the sentence (`str(reason)`).

        Raises
        ------
        DynidentError
            Where there is no such effect or joint, or the diagnosis holds no reasons.

        Examples
        --------
        >>> diagnosis.why_not("backlash", "elbow")  # doctest: +SKIP
        Reason(too_small: …)
        """
        effect, _, at = effect.partition("@")
        joint = joint or at
        get_effect(effect, "effect")
        if not self.outcomes:
            raise DynidentError("this diagnosis was made by an earlier version and holds no reasons; diagnose again")
        outcome = find_outcome(self.outcomes, effect, joint)
        if outcome is not None:
            return outcome.reason
        joints = dict.fromkeys(name for outcome in self.outcomes for name in outcome.choice.joints)
        if joint and joint not in joints:
            raise DynidentError(describe_missing_joint(joint, joints), pointer="joint")
        # Inertia is never a candidate: it is the model itself.
        return Reason.build("not_tried", why="it is part of every model")

    def __repr__(self) -> str:
        since = "" if self.changes is None else f", {len(self.changes)} changes"
        return f"Diagnosis({self.verdict}{since}: {self.summary})"
