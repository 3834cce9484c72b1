"""Catalogue of experiments that tell two effects apart, and the choice of the one that decides between them.

Holds the speeds of the proposed motions, which experiment an effect asks for, and the types of a proposal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from dynident.diagnosis import Diagnosis
from dynident.diagnosis.ambiguities import Doubt
from dynident.diagnosis.outcome_reasons import describe_place
from dynident.effects import Effect, EffectChoice, ExperimentKind, get_effect
from dynident.excitation import CriterionChoice, DesignRequest, TrajectoryRequest
from dynident.motion.limits.bounds import Bounds
from dynident.number_format import format_number


def choose_experiment(suspect: str, rival: str | None) -> Experiment:
    """Return the experiment that decides between two effects, between two places of one, or that shows one.

    Parameters
    ----------
    suspect : str
        Id of the effect that was found.
    rival : str or None
        Id of the effect that it may be instead; the same id asks for the place, None for the effect alone.

    Returns
    -------
    Experiment
    """
    effect = get_effect(suspect)
    # The same effect at two places: the kind of experiment that finds the place, not the effect, is needed.
    if suspect == rival:
        return EXPERIMENTS[effect.place_experiment]
    kind = None if rival is None else _find_distinguishing_kind(effect, get_effect(rival))
    return EXPERIMENTS[kind or effect.experiment]


def _find_distinguishing_kind(first: Effect, second: Effect) -> ExperimentKind | None:
    """Return the kind of experiment that tells two effects apart, as either of them names it."""
    for effect, rival in ((first, second), (second, first)):
        for kind, others in effect.told_from.items():
            if rival.id in others:
                return kind
    return None


_STARTS, _RANDOM = 1, 20
"""Starts of the optimisation that a proposed design asks for, and random trajectories to start from.

A number of starts instead of seconds: the same request then gives the same motion on a busy server as here, where it is
rehearsed to promise what it reaches. One start takes 1-3 s; ten seconds of them take another 0-30 % off the standard
deviation."""
# Strokes of the reversal experiment: at most this share of half the joint's range, and so many slip distances each.
_MOST_STROKES_SLIP, _SLIP_AMPLITUDES = 0.25, (1.0, 2.0, 4.0, 8.0, 16.0)
# The slip distance in rad or m where no model gives one, and how many of them the joint crosses in a second.
_SLIP, _SLIPS_PER_SECOND = 2e-3, 4.0
# Shares of the joints' speed limits; around a Stribeck peak, multiples of the Stribeck velocity take the place of the
# slow ones.
_SLOW_SPEEDS: tuple[float, ...] = (0.02, 0.05, 0.1)
_PEAK_SPEEDS, _FAST_SPEEDS = (0.25, 0.5, 1.0, 2.0), (0.2, 0.4, 0.7)
_SLOWEST = 0.002
# Hz at which a ripple shall appear in the torque, and the shortest and longest sweep in s.
_RIPPLE_FREQUENCY, _SWEEP = 2.0, (20.0, 120.0)


@dataclass(frozen=True)
class Question:
    """The question that an experiment has to decide.

    Parameters
    ----------
    effects : tuple of EffectChoice
        Effects of the model, and all that was found beside the suspect.
    suspect : EffectChoice
        The effect that was found, or could not be seen.
    rival : EffectChoice or None
        What else the suspect may be; None where it could not be seen.
    joints : tuple of str
        Names of the joints that the experiment has to move.
    bounds : Bounds
        Limits of the motion.
    noise : mapping of str to float
        Standard deviation of the torque noise of a sample by joint, N m or N.
    rate : float
        Samples a second, Hz.
    """

    effects: tuple[EffectChoice, ...]
    suspect: EffectChoice
    rival: EffectChoice | None
    joints: tuple[str, ...]
    bounds: Bounds
    noise: Mapping[str, float]
    rate: float

    @property
    def rivals(self) -> tuple[EffectChoice, ...]:
        """The suspect and, where there is one, its rival."""
        return (self.suspect,) if self.rival is None else (self.suspect, self.rival)

    @property
    def is_about_place(self) -> bool:
        """Whether the suspect and its rival are the same effect at two places."""
        return self.rival is not None and self.rival.effect == self.suspect.effect

    def get_shape_constant(self, name: str, otherwise: float) -> float:
        """Return a shape constant of the suspect or its rival, `otherwise` where neither has it.

        Parameters
        ----------
        name : str
            Name of the shape constant.
        otherwise : float
            The value where neither effect has it.

        Returns
        -------
        float
            Value of the constant, in its unit.
        """
        for choice in self.rivals:
            if name in choice.shape_values:
                return choice.shape_values[name]
        return otherwise

    @property
    def joint_indices(self) -> list[int]:
        """Numbers of the joints in question."""
        return [self.bounds.names.index(name) for name in self.joints]

    def build_request(self, kind: str, trajectory: TrajectoryRequest) -> DesignRequest:
        """Build the request for a motion that separates the suspect from its rival.

        Parameters
        ----------
        kind : str
            Kind of design, such as "optimized".
        trajectory : TrajectoryRequest
            The motion that the kind of experiment needs.

        Returns
        -------
        DesignRequest
            A design for the model with both rivals in it, by the criterion "separation".
        """
        # At two places an effect has much in common: what is the suspect's own stands behind all of its rival.
        separated, pair = (self.rivals[:1], self.rivals[::-1]) if self.is_about_place else (self.rivals, self.rivals)
        return DesignRequest(
            kind=kind,
            effects=(*self.effects, *pair),
            criterion=CriterionChoice("separation", effects=separated),
            trajectory=trajectory,
            noise=self.noise,
            starts=_STARTS if kind == "optimized" else None,
            random_trajectories=_RANDOM,
        )


@dataclass(frozen=True)
class Experiment:
    """A kind of experiment: in words, as a design, and what people have to do.

    Parameters
    ----------
    words : str
        The experiment as the subject of a sentence.
    design : callable
        Function that makes the design request for a question.
    instructions : tuple of str
        What people have to do besides running the motion.
    predictable : bool
        Whether the motion alone decides, so that its result can be predicted.
    """

    words: str
    design: Callable[[Question], DesignRequest]
    instructions: tuple[str, ...] = ()
    # Where the decision rests on something that is not in the trajectory, nothing can be predicted from it.
    predictable: bool = True


def _request_constant_speeds(question: Question) -> DesignRequest:
    """Request constant speeds around a Stribeck peak, where there is one, and up to the limit."""
    # Friction falls from static to Coulomb friction around the Stribeck velocity, so the slow speeds lie on both sides
    # of it.
    peak = question.get_shape_constant("vs", 0.0)
    slow = _SLOW_SPEEDS
    if peak:
        limit = float(question.bounds.velocity[question.joint_indices].min())
        slow = tuple(factor * peak / limit for factor in _PEAK_SPEEDS)
    # Rounded, and each speed once: two shares that the clipping makes equal would be measured twice.
    speeds = sorted({round(float(np.clip(share, _SLOWEST, 1.0)), 5) for share in (*slow, *_FAST_SPEEDS)})
    single = len(question.joints) == 1
    return question.build_request(
        "constant_velocity",
        TrajectoryRequest(
            duration=4.0,
            periods=2 if single else 1,
            sampling_rate=question.rate,
            speeds=tuple(speeds),
            joints=question.joints,
        ),
    )


def _request_slow_sweep(question: Question) -> DesignRequest:
    """Request a sweep so slow that the waves of a ripple stay within the filter's band."""
    # A ripple of k waves a turn that is crossed at a speed v has the frequency k v / 2π; the duration keeps that at
    # _RIPPLE_FREQUENCY on the joint with the longest way.
    widths = 2 * question.bounds.half_range[question.joint_indices]
    duration = float(widths.max()) * abs(question.get_shape_constant("k", 6.0)) / (2 * np.pi * _RIPPLE_FREQUENCY)
    return question.build_request(
        "slow_sweep",
        TrajectoryRequest(
            duration=round(float(np.clip(duration, *_SWEEP)), 1),
            sampling_rate=question.rate,
            joints=question.joints,
        ),
    )


def _request_reversals(question: Question) -> DesignRequest:
    """Request strokes from the slip distance upwards, so slow that the filter shows how sliding sets in."""
    slip = question.get_shape_constant("d0", _SLIP)
    largest_amplitude = _MOST_STROKES_SLIP * float(question.bounds.half_range[question.joint_indices].min())
    # Presliding friction differs from Coulomb friction within a few slip distances of a reversal only; longer strokes
    # show what it tends to.
    amplitudes = sorted({round(min(factor * slip, largest_amplitude), 6) for factor in _SLIP_AMPLITUDES})
    fastest = float(question.bounds.velocity[question.joint_indices].min())
    speed = float(np.clip(_SLIPS_PER_SECOND * slip / fastest, _SLOWEST, 0.2))
    return question.build_request(
        "reversals",
        TrajectoryRequest(
            periods=3,
            sampling_rate=question.rate,
            speeds=(round(speed, 5),),
            amplitudes=tuple(amplitudes),
            joints=question.joints,
        ),
    )


def _request_whole_range(question: Question) -> DesignRequest:
    return question.build_request("optimized", TrajectoryRequest(duration=20.0, sampling_rate=question.rate))


def _request_repeated_motion(question: Question) -> DesignRequest:
    return question.build_request("optimized", TrajectoryRequest(periods=4, sampling_rate=question.rate))


def _request_paces(question: Question) -> DesignRequest:
    return question.build_request("optimized", TrajectoryRequest(sampling_rate=question.rate, paces=(1.0, 0.5, 0.25)))


def _request_warm_up_session(question: Question) -> DesignRequest:
    return question.build_request(
        "constant_velocity",
        TrajectoryRequest(duration=4.0, sampling_rate=question.rate, speeds=(0.1, 0.4, 0.7), joints=question.joints),
    )


_ONE_BY_ONE = (
    "Joints stand still in this motion: identify and diagnose from it together with the present data. Do not give it "
    'the role "friction", which leaves it out of both.',
)

EXPERIMENTS: Mapping[ExperimentKind, Experiment] = MappingProxyType(
    {
        "constant_speeds": Experiment(
            "Constant speeds in both directions, slow and fast,", _request_constant_speeds, _ONE_BY_ONE
        ),
        "slow_sweep": Experiment(
            "A slow sweep over the whole range, in both directions,", _request_slow_sweep, _ONE_BY_ONE
        ),
        "reversals": Experiment(
            "Slow motion back and forth by small, growing amplitudes", _request_reversals, _ONE_BY_ONE
        ),
        "whole_range": Experiment(
            "A motion of all joints over the whole range, designed for this,", _request_whole_range
        ),
        "as_it_is": Experiment(
            "A motion of all joints over the whole range, with the added object still in place,",
            _request_whole_range,
            (
                "Leave the added object where it is, as in the recordings that showed it, and record the motion "
                "with it.",
                "Send the recording to the diagnosis, together with the present data.",
            ),
        ),
        "paces": Experiment("The same path at full speed, at half and at a quarter of it", _request_paces),
        "with_payload": Experiment(
            "The same motion without and with a payload",
            _request_repeated_motion,
            (
                "Run the motion as it is, then again with a payload of known mass: half of what the robot may carry.",
                "Send both recordings to the diagnosis, together with the present data, and state the payload of "
                "the second.",
            ),
        ),
        "cold_and_warm": Experiment(
            "The same motion with a cold and with a warm robot",
            _request_warm_up_session,
            (
                "Run the motion with the robot cold, after a night without motion.",
                "Let it work for an hour at its usual pace, and run the motion again.",
                "Pause for half an hour with the drives off, and run it a third time: then the temperature has "
                "fallen although more time has passed.",
                "Record the temperature of the joints, and record the time of day without a reset through all three "
                "runs.",
            ),
            predictable=False,
        ),
        "repeated": Experiment(
            "The same motion four times, with nothing touching the arm,",
            _request_repeated_motion,
            (
                "Take care that nothing touches the arm, and that the base stands firm.",
                "Torque that repeats with the motion belongs to the robot; the rest is an external disturbance.",
            ),
            predictable=False,
        ),
    }
)
"""Kinds of experiments by name."""


@dataclass(frozen=True)
class Separation:
    """How well an effect can be told from all else that may explain the same residual.

    Parameters
    ----------
    parameter : str
        Name of the parameter of the effect that comes out best.
    unit : str
        Unit of the parameter and of its standard deviation.
    share : float
        Share of the parameter's column that is left beside the model and the rival, 0 to 1.
    standard_deviation : float
        Standard deviation of the parameter; infinite where nothing determines it.
    t_value : float or None
        Amplitude found so far over the standard deviation; None where none is known.
    """

    parameter: str
    unit: str
    share: float
    standard_deviation: float
    t_value: float | None


@dataclass(frozen=True)
class NextExperiment:
    """A motion that would tell more: why, the design, and what people have to do besides running it.

    Parameters
    ----------
    reason : str
        Why this experiment, and what it should give, in words for the user.
    design : DesignRequest
        The request for the motion.
    present_separation : Separation, optional
        How well the data at hand tell the effects apart; None where the answer rests on more than the motion, such as a
        temperature or a touch.
    expected_separation : Separation, optional
        How well these data and the motion together will tell them apart; None as above.
    instructions : tuple of str
        What people have to do besides running the motion.
    """

    reason: str
    design: DesignRequest
    present_separation: Separation | None = None
    expected_separation: Separation | None = None
    instructions: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """Kind of the design."""
        return self.design.kind


@dataclass(frozen=True, eq=False, repr=False)
class AdvisedDiagnosis(Diagnosis):
    """A diagnosis, and the experiment that would decide what it leaves open.

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
    outcomes : tuple of Outcome
        What became of every effect on every joint, and why.
    detection_limits : tuple of DetectionLimit
        The smallest size of each effect on each joint that these recordings would have shown.
    conclusion : Conclusion, optional
        What all this says, and the next thing to do.
    next_experiment : NextExperiment, optional
        The proposed experiment; None where a motion decides nothing.
    """

    next_experiment: NextExperiment | None = None


def _word_rival(rival: EffectChoice, suspect: EffectChoice) -> str:
    return f"the same effect on {describe_place(rival.joints)}" if rival.effect == suspect.effect else _get_title(rival)


def _get_title(choice: EffectChoice) -> str:
    return get_effect(choice.effect).title


def word_reason(
    experiment: Experiment, question: Question, doubt: Doubt, present: Separation | None, reached: Separation | None
) -> str:
    """Word what an experiment is for, and how well it will determine the deciding parameter.

    Parameters
    ----------
    experiment : Experiment
        The kind of experiment.
    question, doubt : Question, Doubt
        What it is to decide.
    present, reached : Separation, optional
        How well the two are told apart now, and with the experiment.
    """
    suspect = _get_title(doubt.suspect)
    where = describe_place(question.joints) if get_effect(doubt.suspect.effect).scope == "joint" else "the whole robot"
    if doubt.rivals:
        others = [_word_rival(rival, doubt.suspect) for rival in doubt.rivals]
        purpose = f"distinguish {suspect} from {' or '.join(others)}"
    else:
        purpose = f"show whether {suspect} is present"
    text = f"{experiment.words} would {purpose} on {where}."
    if any(rival.effect == doubt.suspect.effect for rival in doubt.rivals):
        text = f"{experiment.words} would distinguish {suspect} on {where} from {' or '.join(others)}."
    if present is None or reached is None:
        return text
    unit = "" if reached.unit == "-" else f" {reached.unit}"
    was = f"now {present.standard_deviation:.2g}" if np.isfinite(present.standard_deviation) else "now undetermined"
    text = f"{text} It should determine {reached.parameter} to within {reached.standard_deviation:.2g}{unit} ({was})"
    if reached.t_value is None or present.t_value is None:
        return f"{text}."
    reaches, is_now = format_number(reached.t_value), format_number(present.t_value)
    return f"{text}. The value found would then be {reaches} standard deviations from zero (now {is_now})."
