"""Contact thresholds of a momentum observer, the smallest force that they detect, its delay, the rate of false alarms.

Thresholds come from the observer's residual on held-out recordings, by joint, apart for joints that move slowly or have
just done so and for three classes of speed: friction at reversals must not blunt the whole motion. Residuals are
correlated in time, so the tail is estimated from the largest values of seconds, not of samples (Coles 2001, ch. 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.estimation.residual_errors import BLOCK, compute_block_maxima, compute_threshold
from dynident.identification import Identification
from dynident.identification.thresholds import ValidationOutcome
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording
from dynident.robot import Robot, compute_tool_jacobian, draw_unit_forces
from dynident.validation.momentum_observer import (
    GAIN,
    WITHIN,
    ObservedContacts,
    Run,
    compute_step_response,
    observe_recording,
)

FALSE_ALARMS_AN_HOUR = 1.0
"""What a detector may cost: a cell that stops for nothing more than once an hour is switched off."""

FEWEST_BLOCKS = 15
"""Seconds of held-out motion, at least: from fewer largest values no tail is estimated."""

SEEN = 0.95
"""Share of postures along the held-out motion and of directions in which the force that is stated shows."""

HAND_CONTACT_FORCE_LIMIT = 140.0
"""Example of a force in N that a hand or a chest may bear while it is clamped. Secondary sources give it as that of
ISO/TS 15066:2016, table A.2 (for hands arXiv:2311.13814, table 1); the standard itself was not read, and some sources
give others. The limits that count are those of the user's risk assessment."""

_SPEED_CLASSES = 3
# Seconds of a class of speed, at least, that tell how large its residual is.
_FEWEST_OF_CLASS = 3.0
# The residual of each class is measured by this quantile, near the tail but still of many samples.
_SCALE = 0.99
# Times the held-out motion over which one alarm is stated at most: further out, nothing has tested the tail.
_FARTHEST = 20.0
# Postures along the motion that a force is tried in.
_POSTURES = 200
WRONG_IN_SOME_MOTIONS = "The model is wrong in some of the recordings more than in the others."
"""What it means that the rate of false alarms is disproved."""

# Chance of as many false alarms as were counted, from which on the stated rate is disproved.
_DISPROVED = 0.01


@dataclass(frozen=True, eq=False)
class ContactDetection:
    """Thresholds of a momentum observer, and the force at the tool that they detect.

    Parameters
    ----------
    force : float
        Force in N at the tool that shows in nearly all postures and directions of the held-out motion, while at least
        one joint moves.
    within : float
        Seconds within which it shows.
    false_alarms_an_hour : float
        Rate that the thresholds are made for.
    gain : float
        Bandwidth of the observer in 1/s.
    speeds : (n, 2)
        Speeds, in rad/s or m/s, between the three classes of each joint.
    thresholds : (n, 4)
        Thresholds on each joint's residual, in N m or N: where it is slow or has just been, then by class of speed.
        Infinite where the joint was not recorded long enough.
    seconds : float
        Held-out motion in s that they come from.
    requested : float
        Rate that was asked for. It is below `false_alarms_an_hour` where the held-out motion is too short to state it.
    force_at_rest : float or None
        The same force where all joints are slow or have just been, and static friction hides contacts; None where that
        does not come up.
    """

    force: float
    within: float
    false_alarms_an_hour: float
    gain: float
    speeds: FloatArray
    thresholds: FloatArray
    seconds: float
    requested: float = FALSE_ALARMS_AN_HOUR
    force_at_rest: float | None = None

    @property
    def false_alarms_per_hour(self) -> float:
        """The same as `false_alarms_an_hour`, by the name that requests have for it."""
        return self.false_alarms_an_hour

    def compute_thresholds(self, observed: ObservedContacts) -> FloatArray:
        """Return the threshold (m, n) of every sample."""
        return np.take_along_axis(self.thresholds.T, _find_classes(observed, self.speeds), axis=0)

    def find_contacts(self, observed: ObservedContacts) -> BoolArray:
        """Return whether each joint's residual is beyond its threshold, or not a number (m, n)."""
        # After a sample that is not a number the residual stays none: that must not look like no contact.
        return ~np.asarray(np.abs(observed.residual) <= self.compute_thresholds(observed))

    def count_alarms(self, observed: ObservedContacts, period: float) -> int:
        """Count the alarms of a motion, sampled every `period` s; the second after an alarm belongs to it."""
        times = period * np.flatnonzero(self.find_contacts(observed).any(axis=1))
        count, end = 0, -np.inf
        for time in times:
            if time >= end:
                count, end = count + 1, time + BLOCK
        return count

    def describe(self) -> str:
        """Describe what is detected, in a sentence or two."""
        at_rest = ""
        if self.force_at_rest is not None:
            at_rest = f" ({_format_force(self.force_at_rest)} where it stands or all joints are slow)"
        text = (
            f"A momentum observer detects {_format_force(self.force)} at the tool in {1e3 * self.within:.0f} ms while "
            f"the arm moves{at_rest}, with {_format_rate(self.false_alarms_an_hour)} (in "
            f"{format_percent(SEEN, decimals=0)} of directions and postures of the held-out motion, "
            f"{self.seconds:.0f} s)."
        )
        if self.false_alarms_an_hour <= self.requested:
            return text
        needed = 3600.0 / self.requested / _FARTHEST
        return f"{text} To state {_format_rate(self.requested)}, hold out {np.ceil(needed):.0f} s."


def _format_force(force: float) -> str:
    # Two digits, but no power of ten.
    return f"{float(f'{force:.2g}'):g} N" if np.isfinite(force) else "no force"


def _format_rate(rate: float) -> str:
    digits = float(f"{rate:.2g}")
    return f"{digits:g} false alarm{'' if digits == 1 else 's'} an hour"


@single_threaded
def calibrate_contact_detection(
    identification: Identification,
    recordings: Sequence[Recording],
    *,
    false_alarms_per_hour: float = FALSE_ALARMS_AN_HOUR,
    gain: float = GAIN,
) -> ContactDetection | None:
    """Find thresholds for a momentum observer on held-out recordings, and the force at the tool that they detect.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Held-out recordings without contacts.
    false_alarms_per_hour : float
        False alarms an hour, of all joints together, that the thresholds are made for. Where the recordings are too
        short to state so few, they are made for the fewest that can be stated.
    gain : float
        Bandwidth of the observer in 1/s.

    Returns
    -------
    ContactDetection or None
        None where the recordings are too short for any threshold, or no joint feels a force at the tool.

    Raises
    ------
    DynidentError
        As `MomentumObserver` does; or for a rate that is not above 0.
    """
    _check_rate(false_alarms_per_hour)
    runs = [run for recording in recordings for run in observe_recording(identification, recording, gain)]
    return fit_contact_detection(identification.model.robot, runs, false_alarms_per_hour, gain)


def explain_no_detection(identification: Identification, recordings: Sequence[Recording]) -> str:
    """Return why recordings give no thresholds, or no force that these detect, in a sentence.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Held-out recordings of which `calibrate_contact_detection` has made nothing.
    """
    robot = identification.model.robot
    silent = set(robot.joints_without_torque)
    lacking = [sorted(set(recording.joints_without_torque) - silent) for recording in recordings]
    if lacking and all(lacking):
        fewest = min(lacking, key=len)
        return f"No recording has the torque of {', '.join(fewest)}, which the observer needs."
    runs = [run for recording in recordings for run in observe_recording(identification, recording)]
    detection = _fit_thresholds(robot, runs, FALSE_ALARMS_AN_HOUR)
    if detection is None or not np.isfinite(detection.thresholds).any():
        return f"The recordings have less than {FEWEST_BLOCKS} s of unbroken motion for thresholds."
    return "A force at the tool does not show at the joints in nearly all directions and postures."


def _check_rate(false_alarms_per_hour: float) -> None:
    if not (np.isfinite(false_alarms_per_hour) and false_alarms_per_hour > 0):
        raise DynidentError(
            f"false_alarms_per_hour is {false_alarms_per_hour}; give a number above 0",
            pointer="/false_alarms_per_hour",
        )


def fit_contact_detection(
    robot: Robot, runs: Sequence[Run], false_alarms_an_hour: float, gain: float = GAIN
) -> ContactDetection | None:
    """Find the thresholds that residuals without contacts cross at a rate, and the force that they detect.

    Parameters
    ----------
    robot : Robot
        The robot.
    runs : sequence of (ObservedContacts, float)
        Residuals of motions without contacts, each with its sampling period in s.
    false_alarms_an_hour : float
        Rate of all joints together.
    gain : float
        Bandwidth of the observer in 1/s.

    Returns
    -------
    ContactDetection or None
        None where the motions are too short, or no joint feels a force at the tool.
    """
    detection = _fit_thresholds(robot, runs, false_alarms_an_hour, gain)
    force, at_rest = (None, None) if detection is None else compute_contact_forces(robot, runs, detection)
    return None if detection is None or force is None else replace(detection, force=force, force_at_rest=at_rest)


def _fit_thresholds(
    robot: Robot, runs: Sequence[Run], false_alarms_an_hour: float, gain: float = GAIN
) -> ContactDetection | None:
    """Return the thresholds without the force that they detect, which takes most of the time."""
    seconds = float(sum(len(run.residual) * period for run, period in runs))
    if seconds < FEWEST_BLOCKS:
        return None
    rate = max(false_alarms_an_hour, 3600.0 / (_FARTHEST * seconds))
    speeds = np.array([_split_speeds([run for run, _ in runs], joint) for joint in range(robot.n)])
    # Each joint may raise an alarm, so each has its share of the false alarms.
    share = rate / 3600.0 * BLOCK / max(int(np.sum(robot.has_torque)), 1)
    thresholds = np.full((robot.n, _SPEED_CLASSES + 1), np.inf)
    for joint in np.flatnonzero(robot.has_torque):
        thresholds[joint] = _compute_joint_thresholds(runs, speeds, int(joint), share)
    return ContactDetection(
        np.inf, WITHIN / gain, rate, gain, speeds, thresholds, seconds, requested=false_alarms_an_hour
    )


def _split_speeds(runs: Sequence[ObservedContacts], joint: int) -> FloatArray:
    """Return the speeds (2,) that split the samples in which a joint moves into three classes of equal size."""
    moving = np.concatenate([np.abs(run.dq[~run.slow[:, joint], joint]) for run in runs])
    if not len(moving):
        return np.full(_SPEED_CLASSES - 1, np.inf)
    return np.asarray(np.quantile(moving, np.arange(1, _SPEED_CLASSES) / _SPEED_CLASSES))


def _find_classes(observed: ObservedContacts, speeds: FloatArray) -> NDArray[np.intp]:
    """Return (m, n): 0 where a joint is slow or has just been, else 1, 2, 3 by its speed."""
    classes = 1 + (np.abs(observed.dq)[..., None] > speeds).sum(axis=-1)
    return np.where(observed.slow, 0, classes)


def _compute_joint_thresholds(runs: Sequence[Run], speeds: FloatArray, joint: int, share: float) -> FloatArray:
    """Return the thresholds (4,) of a joint, one a class."""
    sizes = [np.abs(run.residual[:, joint]) for run, _ in runs]
    classes = [_find_classes(run, speeds)[:, joint] for run, _ in runs]
    size, number = np.concatenate(sizes), np.concatenate(classes)
    seconds = np.concatenate([np.full(len(run.residual), period) for run, period in runs])
    scales = np.empty(_SPEED_CLASSES + 1)
    for k in range(len(scales)):
        # A class with too few seconds has no scale of its own; the joint's as a whole stands for it.
        own = number == k if seconds[number == k].sum() >= _FEWEST_OF_CLASS else ...
        scales[k] = max(np.quantile(size[own], _SCALE), np.finfo(float).tiny)
    # In units of their class, residuals at all speeds have one tail. Slow joints have another: friction bounds it. Each
    # of the two has half of the joint's share.
    relative = [own / scales[k] for own, k in zip(sizes, classes, strict=True)]
    whole = [compute_block_maxima(own, step) for own, (_, step) in zip(relative, runs, strict=True)]
    if sum(map(len, whole)) < FEWEST_BLOCKS:
        return np.full(len(scales), np.inf)
    thresholds = np.empty(len(scales))
    for group in (slice(0, 1), slice(1, None)):
        inside = np.zeros(len(scales), dtype=bool)
        inside[group] = True
        apart = [
            compute_block_maxima(np.where(inside[k], own, 0.0), step)
            for own, k, (_, step) in zip(relative, classes, runs, strict=True)
        ]
        is_rare = sum(int(np.count_nonzero(part)) for part in apart) < FEWEST_BLOCKS
        maxima = [part for part in (whole if is_rare else apart) if len(part)]
        thresholds[group] = scales[group] * compute_threshold(maxima, share / 2)
    return thresholds


def compute_contact_forces(
    robot: Robot, runs: Sequence[Run], detection: ContactDetection
) -> tuple[float | None, float | None]:
    """Return the forces in N that show within the stated time in nearly all postures and directions.

    The first is for moments in which a joint moves, the second for those in which all are slow or have just been; None
    where there are no such moments, or the force does not show.

    Parameters
    ----------
    robot : Robot
        The robot.
    runs : sequence of (ObservedContacts, float)
        Residuals of motions without contacts, each with its sampling period in s.
    detection : ContactDetection
        The thresholds.
    """
    moving: list[FloatArray] = []
    slow: list[FloatArray] = []
    total = sum(len(run.q) * period for run, period in runs)
    hidden = _measure_hiding_friction([run for run, _ in runs])
    for run, period in runs:
        window = max(1, round(detection.within / period))
        if len(run.q) <= window + 1:
            continue
        each = int(np.ceil(_POSTURES * len(run.q) * period / total))
        starts = np.linspace(0, len(run.q) - window - 1, each).astype(np.intp)
        jacobian = compute_tool_jacobian(robot, run.q[starts])
        forces = draw_unit_forces(jacobian)
        if forces is None:
            return None, None
        torque = np.einsum("mdi,mij->mdj", forces, jacobian)
        thresholds = detection.compute_thresholds(run)
        response = compute_step_response(period * np.arange(1.0, window + 1.0), detection.gain)
        for start, unit in zip(starts, torque, strict=True):
            rows = slice(start + 1, start + 1 + window)
            # The residual of a joint that moves is there already, and helps or hinders the force on its way to the
            # threshold. One that stands shows nothing before the force has overcome its static friction.
            helps = np.where(run.slow[rows, None, :], -hidden, np.sign(unit) * run.residual[rows, None, :])
            margin = thresholds[rows, None, :] - helps
            with np.errstate(divide="ignore", invalid="ignore"):
                needed = np.maximum(margin, 0.0) / (np.abs(unit) * response[:, None, None])
            least = np.nan_to_num(needed, nan=np.inf, posinf=np.inf).min(axis=(0, 2))
            (slow if run.slow[start].all() else moving).append(least)
    return _find_quantile(moving), _find_quantile(slow)


def _measure_hiding_friction(runs: Sequence[ObservedContacts]) -> FloatArray:
    """Return the static friction (n,) that nearly always is enough to explain the residual of slow joints."""
    residual, slow = (np.concatenate([getattr(run, name) for run in runs]) for name in ("residual", "slow"))
    return np.array(
        [np.quantile(np.abs(own[at]), SEEN) if at.any() else 0.0 for own, at in zip(residual.T, slow.T, strict=True)]
    )


def _find_quantile(forces: Sequence[FloatArray]) -> float | None:
    if not forces:
        return None
    # Between two forces that are infinite there is none.
    with np.errstate(invalid="ignore"):
        force = float(np.quantile(np.concatenate(forces), SEEN))
    return force if np.isfinite(force) else None


@dataclass(frozen=True, eq=False)
class CollisionValidation:
    """Contact detection with a model: what held-out recordings state, tried on each of them in turn.

    Parameters
    ----------
    contact : ContactDetection or None
        Thresholds from all recordings, and the force that they detect; None where there are none.
    alarms : int
        False alarms in the recordings, each with thresholds from the others; 0 for a single recording.
    expected : float
        How many were to be expected there at the stated rates.
    judged : ValidationOutcome
        Whether contacts are detected as stated, and the reason.
    """

    contact: ContactDetection | None
    alarms: int
    expected: float
    judged: ValidationOutcome

    @property
    def is_disproved(self) -> bool:
        """Whether the left-out recordings have far more false alarms than twice those expected."""
        return self.alarms > 0 and float(pdtrc(self.alarms - 1, 2.0 * self.expected)) < _DISPROVED

    def describe(self) -> str:
        """Describe what is detected, and how the rate of false alarms did on left-out recordings."""
        text = "" if self.contact is None else self.contact.describe()
        if not self.expected > 0:
            return text
        counted = f"{self.alarms} false alarm{'' if self.alarms == 1 else 's'}"
        return (
            f"{text} With thresholds from the other recordings, {counted} came up where {self.expected:.2g} were "
            "expected."
        )


@single_threaded
def validate_collision(
    identification: Identification,
    recordings: Sequence[Recording],
    false_alarms_per_hour: float = FALSE_ALARMS_AN_HOUR,
    progress: Progress = ignore_progress,
) -> CollisionValidation:
    """Find contact thresholds, the force that they detect, and whether left-out recordings keep the rate of alarms.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Held-out recordings without contacts.
    false_alarms_per_hour : float
        False alarms an hour that are asked for.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    CollisionValidation
        Passes where a force that people may bear is detected and the alarms do not disprove the rate.

    Raises
    ------
    DynidentError
        For a rate that is not above 0, or a model that an observer cannot use.
    """
    _check_rate(false_alarms_per_hour)
    robot = identification.model.robot
    runs: list[list[Run]] = []
    for k, recording in enumerate(recordings):
        progress(k / (2 * len(recordings)), "observing the momentum")
        runs.append(observe_recording(identification, recording))
    contact = fit_contact_detection(robot, [run for own in runs for run in own], false_alarms_per_hour)
    alarms, expected = 0, 0.0
    for k, left_out in enumerate(runs):
        progress((len(runs) + k) / (2 * len(runs)), "counting false alarms")
        others = [run for own in (*runs[:k], *runs[k + 1 :]) for run in own]
        detection = _fit_thresholds(robot, others, false_alarms_per_hour)
        if detection is not None:
            alarms += sum(detection.count_alarms(*run) for run in left_out)
            seconds = sum(len(run.residual) * period for run, period in left_out)
            expected += detection.false_alarms_an_hour * seconds / 3600.0
    validation = CollisionValidation(contact, alarms, expected, ValidationOutcome("pass", ""))
    if contact is None:
        judged = ValidationOutcome("not_evaluated", explain_no_detection(identification, recordings))
    else:
        judged = _judge_detection(validation, contact)
    return replace(validation, judged=judged)


def _judge_detection(validation: CollisionValidation, contact: ContactDetection) -> ValidationOutcome:
    text = validation.describe()
    if validation.is_disproved:
        return ValidationOutcome("fail", f"{text} {WRONG_IN_SOME_MOTIONS}")
    if contact.force > HAND_CONTACT_FORCE_LIMIT:
        limit = f"{HAND_CONTACT_FORCE_LIMIT:g} N, an example of what a clamped hand can bear"
        return ValidationOutcome("fail", f"{text} This is above {limit}.")
    return ValidationOutcome("pass", text)
