"""Validation by simulation: a robot under joint control, and one that is left alone, against recorded motion (§12.7).

A simulator that follows a recorded motion under joint control hides what its model lacks: the controller makes up for
it. So the drift without a controller counts as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.identification import Identification, make_physical
from dynident.identification.estimators.identified_robot_simulator import (
    RecordedMotion,
    build_simulator,
    read_longest_piece,
)
from dynident.identification.thresholds import LARGEST_ERROR, LARGEST_OF_JOINT, ValidationOutcome
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Recording, low_pass
from dynident.recordings.joint_phases import SLOW
from dynident.schema.fields import check_value
from dynident.validation.open_loop_drift import (
    Drift,
    describe_impossible,
    describe_unknown_torque,
    find_unknown_torque,
    judge_drift,
    simulate_from_many_starts,
)
from dynident.validation.validation_request import LONGEST_SIMULATED, Simulation


@dataclass(frozen=True, eq=False)
class SimulationValidation:
    """A simulated robot that followed the recorded motion under control, and one that was left alone.

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
        The same over the range that the joint moved through. A controller keeps it small whatever the model.
    drift : Drift or None
        Distance from the recorded motion without a controller, under the measured torque.
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
    drift: Drift | None
    limit: float
    judged: ValidationOutcome


@single_threaded
def validate_simulation(
    identification: Identification,
    recording: Recording,
    limit: float = LARGEST_ERROR,
    longest: float = LONGEST_SIMULATED,
    progress: Progress = ignore_progress,
) -> SimulationValidation:
    """Let a robot with the identified parameters make the recorded motion under joint control, and without any.

    The controlled robot is judged by its torque, since the controller keeps it on the motion. Without a controller the
    measured torque alone moves it, again and again from a measured state; then it is judged by how far it drifts.
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
    check_value(Simulation, "limit", limit)
    check_value(Simulation, "longest", longest)
    motion = read_longest_piece(recording, identification.preprocessing, longest)
    duration = motion.reference.duration
    # Before the simulation: negative friction or inertia would make it diverge without saying why.
    possible = make_physical(identification)
    identification = possible.identification
    if not possible.is_possible:
        judged = ValidationOutcome("fail", describe_impossible(possible))
        return SimulationValidation(recording.name, duration, None, None, None, None, limit, judged)
    try:
        simulator = build_simulator(identification.model, identification.values, speeds=identification.estimate.speeds)
        measured = simulator.follow(motion, scale_progress(progress, 0.05, 0.6))
    except DynidentError as error:
        judged = ValidationOutcome(
            "fail", f"A robot with the identified parameters cannot make this motion: {error.detail}."
        )
        return SimulationValidation(recording.name, duration, None, None, None, None, limit, judged)
    # The simulation may end a sample early or late, by rounding of the duration.
    count = min(len(measured.tau), len(motion.tau))
    still = np.abs(motion.reference.dq[:count]) < SLOW
    errors = _compute_torque_errors(identification, recording, measured.tau[:count], motion.tau[:count], still)
    off = measured.truth.q[:count] - motion.reference.q[:count]
    position = np.sqrt(np.mean(off**2, axis=0))
    span = np.maximum(np.ptp(motion.reference.q, axis=0), 1e-9)
    # A joint that hardly moves has no range to be off by: its share would be noise over nearly zero.
    share = np.where(np.ptp(motion.reference.q, axis=0) > 1e-3, position / span, 0.0)
    unknown = find_unknown_torque(identification, [recording])
    drift_progress = scale_progress(progress, 0.6, 1.0)
    drift = None if unknown else simulate_from_many_starts(simulator, [motion], progress=drift_progress)
    judged = _judge_response(identification, motion, errors, drift, unknown, limit).prepend_reason(possible.note)
    return SimulationValidation(recording.name, duration, errors, position, share, drift, limit, judged)


def _compute_torque_errors(
    identification: Identification, recording: Recording, simulated: FloatArray, measured: FloatArray, still: BoolArray
) -> Errors | None:
    """Return errors behind the parallel filter's low-pass, where it is filled; None where no rows are left.

    A joint does not count while it is `still` (m, n): static friction then holds any torque, another one in either
    robot.
    """
    # Importing it takes half a second, so that only those who need it do.
    from scipy.signal import fftconvolve

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
    identification: Identification,
    motion: RecordedMotion,
    errors: Errors | None,
    drift: Drift | None,
    unknown: Sequence[str],
    limit: float,
) -> ValidationOutcome:
    if errors is None:
        return ValidationOutcome(
            "not_evaluated",
            f"The longest segment, {motion.reference.duration:.1f} s, is too short for the torque filter.",
        )
    names = identification.model.robot.joint_names
    worst = int(np.argmax(np.where(errors.counts > 0, errors.relative, 0.0)))
    text = (
        f"Over {motion.reference.duration:.1f} s, while joints move, the simulated torque differs by "
        f"{format_percent(errors.relative_total, decimals=1)} from the measured one (largest on {names[worst]}, "
        f"{format_percent(errors.relative[worst], decimals=1)})"
    )
    if errors.relative_total > limit:
        return ValidationOutcome("fail", f"{text}, above the limit of {format_percent(limit, 2)}.")
    useless = [
        f"{name} ({format_percent(errors.relative[j], decimals=1)})"
        for j, name in enumerate(names)
        if errors.relative[j] > LARGEST_OF_JOINT
    ]
    if useless:
        return ValidationOutcome(
            "fail", f"{text}, and above {format_percent(LARGEST_OF_JOINT, decimals=0)} on {', '.join(useless)}."
        )
    if unknown:
        return ValidationOutcome("not_evaluated", f"{text}. {describe_unknown_torque(unknown)}")
    if drift is None or np.isnan(drift.worst_share):
        return ValidationOutcome("not_evaluated", f"{text}. The motion is too short to be simulated without control.")
    judged = judge_drift(drift)
    if judged.verdict == "fail":
        return ValidationOutcome("fail", f"{text}. {judged.reason}")
    return ValidationOutcome("pass", f"{text}, within the limit of {format_percent(limit, 2)}. {judged.reason}")
