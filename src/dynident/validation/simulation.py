"""Validate a model by simulation: the simulated response against the recorded one (§12.7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve

from dynident.array_types import BoolArray, FloatArray
from dynident.blas_threads import single_threaded
from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.estimation.uncertainty import NORMAL_95
from dynident.identification import Estimate, Identification
from dynident.identification.estimators.reference_motion import RecordedMotion, read_longest_piece
from dynident.identification.estimators.simulator import build_simulator
from dynident.identification.thresholds import LARGEST_ERROR, LARGEST_OF_JOINT
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Recording, low_pass
from dynident.recordings.phases import SLOW
from dynident.simulation.ground_truth import may_be_negative
from dynident.validation.outcome import ValidationOutcome
from dynident.validation.torque_errors import check_limit

LONGEST = 20.0
"""Seconds of a recording that are simulated at most."""

# Of the joint's range in the recording: how far the simulated joint may be off, root mean square.
_OFF = 0.02


@dataclass(frozen=True, eq=False)
class SimulationValidation:
    """A simulated robot that followed the recorded motion.

    Fields are None where nothing could be simulated.

    Parameters
    ----------
    name : str
        Name of the recording.
    duration : float
        Simulated time in s.
    torque : Errors or None
        Errors of the simulated torque against the measured one while each joint moves, both behind the same low-pass.
    position : (n,) or None
        Root mean square distance of the simulated from the recorded positions, in rad or m.
    position_share : (n,) or None
        The same over the range that the joint moved through.
    limit : float
        Largest relative torque error over all joints that passes.
    judged : ValidationOutcome
        Whether the simulated robot behaves as the recorded one, and the reason.
    """

    name: str
    duration: float
    torque: Errors | None
    position: FloatArray | None
    position_share: FloatArray | None
    limit: float
    judged: ValidationOutcome


@single_threaded
def validate_simulation(
    identification: Identification,
    recording: Recording,
    limit: float = LARGEST_ERROR,
    longest: float = LONGEST,
    progress: Progress = ignore_progress,
) -> SimulationValidation:
    """Let a robot with the identified parameters make the recorded motion under joint control.

    Unlike a prediction of torque along the recorded positions, this integrates the equation of motion: parameters that
    make an indefinite inertia matrix, or friction that drives, do not follow.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recording : Recording
        The recording whose motion is simulated.
    limit : float
        Largest relative torque error over all joints that passes.
    longest : float
        Seconds that are simulated at most, from the longest unbroken segment of the recording.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    SimulationValidation
        Errors of the simulated torque and of the motion, judged against the limit.

    Raises
    ------
    DynidentError
        For a limit or duration that is not above zero, or a recording without motion to follow.
    """
    check_limit(limit)
    if not (np.isfinite(longest) and longest > 0):
        raise DynidentError(f"longest is {longest} s; give a duration above 0", pointer="/longest")
    motion = read_longest_piece(recording, identification.preprocessing, longest)
    duration = motion.reference.duration
    # Before the simulation: negative friction or inertia would make it diverge without saying why.
    impossible = _name_impossible_parameters(identification.estimate)
    if impossible:
        judged = ValidationOutcome("fail", f"No robot has the identified parameters: {impossible}.")
        return SimulationValidation(recording.name, duration, None, None, None, limit, judged)
    try:
        simulator = build_simulator(identification.model, identification.values)
        measured = simulator.follow(motion, scale_progress(progress, 0.05, 1.0))
    except DynidentError as error:
        judged = ValidationOutcome(
            "fail", f"No robot with the identified parameters makes this motion: {error.detail}."
        )
        return SimulationValidation(recording.name, duration, None, None, None, limit, judged)
    # The simulation may end a sample early or late, by rounding of the duration.
    count = min(len(measured.tau), len(motion.tau))
    still = np.abs(motion.reference.dq[:count]) < SLOW
    errors = _compute_torque_errors(identification, recording, measured.tau[:count], motion.tau[:count], still)
    off = measured.truth.q[:count] - motion.reference.q[:count]
    position = np.sqrt(np.mean(off**2, axis=0))
    span = np.maximum(np.ptp(motion.reference.q, axis=0), 1e-9)
    # A joint that hardly moves has no range to be off by: its share would be noise over nearly zero.
    share = np.where(np.ptp(motion.reference.q, axis=0) > 1e-3, position / span, 0.0)
    judged = _judge_response(identification, motion, errors, share, limit)
    return SimulationValidation(recording.name, duration, errors, position, share, limit, judged)


def _name_impossible_parameters(estimate: Estimate) -> str:
    """Name the parameters that are below zero by more than chance, where nature allows no such sign."""
    deviations = estimate.statistics.standard_deviations
    return ", ".join(
        f"{column.name} is {value:.3g} ± {NORMAL_95 * deviation:.2g} {column.unit}, below zero"
        for column, value, deviation in zip(estimate.model.kept, estimate.values, deviations, strict=True)
        if value < -NORMAL_95 * deviation and not may_be_negative(column.effect, column.parameter, column.runs)
    )


def _compute_torque_errors(
    identification: Identification, recording: Recording, simulated: FloatArray, measured: FloatArray, still: BoolArray
) -> Errors | None:
    """Return errors behind the parallel filter's low-pass, where it is filled; None where no rows are left.

    A joint does not count while it is `still` (m, n): static friction then holds any torque, another one in either
    robot.
    """
    taps = low_pass(recording.sampling_rate, identification.preprocessing.torque_cutoff)
    if len(measured) < 2 * len(taps):
        return None
    # Only where the filter is filled: its ends would compare a transient, not the torque.
    smooth = [fftconvolve(tau, taps[:, None], mode="valid", axes=0) for tau in (measured, simulated)]
    # A filtered row is used only where the joint moves over the whole length of the filter.
    touched = fftconvolve(still.astype(np.float64), np.ones((len(taps), 1)), mode="valid", axes=0) > 0.5
    recorded = recording.has_torque & identification.model.robot.has_torque
    counted = ~touched & recorded
    rest, known = (np.where(counted, signal, 0.0) for signal in (smooth[0] - smooth[1], smooth[0]))
    return Errors((rest**2).sum(axis=0), (known**2).sum(axis=0), counted.sum(axis=0).astype(np.float64))


def _judge_response(
    identification: Identification, motion: RecordedMotion, errors: Errors | None, share: FloatArray, limit: float
) -> ValidationOutcome:
    if errors is None:
        return ValidationOutcome(
            "not_evaluated",
            f"The longest unbroken stretch, {motion.reference.duration:.1f} s, is too short for the torque filter.",
        )
    names = identification.model.robot.joint_names
    worst = int(np.argmax(np.where(errors.counts > 0, errors.relative, 0.0)))
    text = (
        f"Over {motion.reference.duration:.1f} s, while joints move, the simulated torque is "
        f"{errors.relative_total:.1%} off the measured one (largest on {names[worst]}, {errors.relative[worst]:.1%})"
    )
    if errors.relative_total > limit:
        return ValidationOutcome("fail", f"{text}, above the limit of {limit:.1%}.")
    useless = [
        f"{name} ({errors.relative[j]:.1%})" for j, name in enumerate(names) if errors.relative[j] > LARGEST_OF_JOINT
    ]
    if useless:
        return ValidationOutcome("fail", f"{text}, and above {LARGEST_OF_JOINT:.0%} on {', '.join(useless)}.")
    lost = [f"{name} ({share[j]:.1%})" for j, name in enumerate(names) if share[j] > _OFF]
    if lost:
        complaint = f"but the simulated robot leaves the recorded motion by more than {_OFF:.0%} of the range on"
        return ValidationOutcome("fail", f"{text}, {complaint} {', '.join(lost)}.")
    followed = f"and it follows the recorded motion within {share.max():.2%} of every joint's range"
    return ValidationOutcome("pass", f"{text}, within the limit of {limit:.1%}, {followed}.")
