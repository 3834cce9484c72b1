"""Drift of a simulation without a controller: it starts from measured states and moves under the measured torque.

The error of the torque becomes one of the position, which a simulator's user feels. Most arms are unstable then (a link
that stands upright falls to either side), so only short times are simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects.hysteresis_states import MemoryStates
from dynident.errors import DynidentError
from dynident.identification import Identification, PhysicalModel, make_physical
from dynident.identification.estimators.identified_robot_simulator import (
    RecordedMotion,
    Simulator,
    build_simulator,
    read_pieces,
)
from dynident.identification.thresholds import LARGEST_DRIFT, ValidationOutcome
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording
from dynident.recordings.joint_phases import STANDS
from dynident.validation.validation_request import HORIZONS

# Step of the integration in s.
_STEP = 1e-3
# Seconds between starts: closer ones tell the same again.
_APART = 0.5
# Starts over all recordings: a mean over more of them hardly changes, and each costs a simulation.
_MOST_STARTS = 60
# s: after longer times most arms have left the motion, whatever the model; they are unstable without a controller.
_JUDGED_UNTIL = 0.5


@dataclass(frozen=True, eq=False)
class Drift:
    """How far a simulated robot drifts from the recorded one under the measured torque.

    Infinite where the simulation diverged, nan where no segment of the recordings is that long.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the joints.
    after : (h,)
        Seconds of simulation after which the drift is given.
    distance : (h, n)
        Root mean square distance of the simulated from the recorded positions, in rad or m.
    speed : (h, n)
        Root mean square difference of the simulated from the recorded velocities, in rad/s or m/s.
    way : (h, n)
        Root mean square of how far the joints moved meanwhile, in rad or m.
    starts : int
        Number of states that simulations were started from.
    """

    joint_names: tuple[str, ...]
    after: tuple[float, ...]
    distance: FloatArray
    speed: FloatArray
    way: FloatArray
    starts: int

    @property
    def share(self) -> FloatArray:
        """Distance over way (h, n). For a joint that hardly moves, over what a standing joint may move."""
        return np.asarray(self.distance / np.maximum(self.way, STANDS))

    @property
    def judged_until(self) -> float:
        """The longest time in s that counts for a verdict: half a second, or the shortest time if all are longer."""
        return max((after for after in self.after if after <= _JUDGED_UNTIL), default=min(self.after))

    @property
    def worst_share(self) -> float:
        """Largest share until `judged_until`; infinite where a simulation diverged, nan where none is that long."""
        short = self.share[np.array(self.after) <= self.judged_until]
        return float(np.nanmax(short)) if not np.isnan(short).all() else np.nan

    def describe(self) -> str:
        """Describe the drift of the worst joint after each time, in a sentence."""
        phrases = []
        for after, share in zip(self.after, self.share, strict=True):
            if np.isnan(share).all():
                continue
            worst = int(np.nanargmax(share))
            size = "all of" if not np.isfinite(share[worst]) else f"{format_percent(share[worst], decimals=0)} of"
            phrases.append(f"{size} its travel after {after:g} s ({self.joint_names[worst]})")
        return f"Without a controller, under the measured torque, the worst joint is off by {', '.join(phrases)}."


@single_threaded
def compute_open_loop_drift(
    identification: Identification,
    recordings: Sequence[Recording],
    horizons: Sequence[float] = HORIZONS,
    progress: Progress = ignore_progress,
) -> Drift:
    """Simulate a robot with the identified parameters, without a controller, from many states of recorded motions.

    Where no robot can have these, the nearest that one can have are simulated (`identification.make_physical`).

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Recordings of the same robot, held out as a rule.
    horizons : sequence of float
        Seconds of simulation after which the drift is given.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    Drift
        Distances after each of the horizons, over all starts.

    Raises
    ------
    DynidentError
        Where no robot can have the identified parameters, no recording has a motion to follow or the torque of every
        joint, or a horizon is not above 0.
    """
    after = tuple(sorted(set(horizons)))
    possible = make_physical(identification).identification
    motions = read_driven_motions(possible, recordings)
    simulator = build_simulator(possible.model, possible.values, speeds=possible.estimate.speeds)
    drift = simulate_from_many_starts(simulator, motions, after, progress)
    if drift is None:
        raise DynidentError(
            f"no segment of the recordings is {after[0]:g} s long; use longer recordings or wider windows",
            pointer="/windows",
            title="Too short",
        )
    return drift


def find_unknown_torque(identification: Identification, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the joints whose torque is unknown in each of the recordings; none where one has the torque of all.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        The recordings.
    """
    known = identification.model.robot.joints_without_torque
    if known or not recordings:
        return known
    return min((recording.joints_without_torque for recording in recordings), key=len)


def describe_unknown_torque(joints: Sequence[str]) -> str:
    """Describe why nothing is simulated under the measured torque, in a sentence.

    Parameters
    ----------
    joints : sequence of str
        Names of the joints whose torque is unknown.
    """
    return f"No recording has the torque of {', '.join(joints)}, which a simulation without a controller needs."


def read_driven_motions(identification: Identification, recordings: Sequence[Recording]) -> list[RecordedMotion]:
    """Read the motions of the recordings that have the torque of every joint.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Recordings of the same robot. Those that lack the torque of a joint are left out: it is stored as 0.

    Raises
    ------
    DynidentError
        Where none has the torque of every joint.
    """
    unknown = find_unknown_torque(identification, recordings)
    if unknown:
        raise DynidentError(describe_unknown_torque(unknown).rstrip("."), title="No torque")
    complete = [recording for recording in recordings if not recording.joints_without_torque]
    return [piece for recording in complete for piece in read_pieces(recording, identification.preprocessing)]


def simulate_from_many_starts(
    simulator: Simulator,
    motions: Sequence[RecordedMotion],
    horizons: tuple[float, ...] = HORIZONS,
    progress: Progress = ignore_progress,
) -> Drift | None:
    """Return the drift from starts spread over the motions; None where no motion is long enough."""
    outcomes = simulate_open_loop(simulator, motions, horizons, progress=progress)
    if outcomes is None:
        return None
    distance, speed, way = (_compute_rms(values) for values in outcomes)
    return Drift(simulator.robot.dynamics.robot.joint_names, horizons, distance, speed, way, len(outcomes[0]))


def simulate_open_loop(
    simulator: Simulator,
    motions: Sequence[RecordedMotion],
    horizons: tuple[float, ...],
    most: int = _MOST_STARTS,
    progress: Progress = ignore_progress,
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Simulate from at most `most` states spread over the motions; None where no motion is long enough.

    The arrays (k, h, n) are the differences of the simulated from the recorded positions and velocities, and the ways
    of the recorded joints, for each start and horizon. A simulation that diverged is infinitely far off; nan marks a
    horizon that its motion does not reach.

    Parameters
    ----------
    simulator : Simulator
        A robot with the identified parameters.
    motions : sequence of RecordedMotion
        Recorded motions with their torque.
    horizons : tuple of float
        Seconds of simulation after which the drift is given, in any order.
    most : int
        Most starts.
    progress : Progress
        Called with the fraction done and a message.

    Raises
    ------
    DynidentError
        For no horizons, or one that is not above 0.
    """
    if not horizons or not all(np.isfinite(horizon) and horizon > 0 for horizon in horizons):
        raise DynidentError(f"horizons is {tuple(horizons)}; give numbers above 0", pointer="/horizons")
    ascending, columns = np.unique(horizons, return_inverse=True)
    sensing = simulator.robot.sensing
    driven = [replace(m, tau=sensing.recover_motor_torque(m.reference, m.tau, m.label)) for m in motions]
    starts = choose_drift_starts(driven, tuple(ascending), most)
    if not starts:
        return None
    position, velocity, way = (
        values[:, columns] for values in _simulate_without_control(simulator, starts, tuple(ascending), progress)
    )
    return position, velocity, way


def choose_drift_starts(
    motions: Sequence[RecordedMotion], horizons: tuple[float, ...] = HORIZONS, most: int = _MOST_STARTS
) -> list[tuple[RecordedMotion, int]]:
    """Return at most `most` motions and samples of them that simulations start from, spread over all motions."""
    starts = [(motion, start) for motion in motions for start in _list_starts(motion, horizons)]
    chosen = np.unique(np.linspace(0, len(starts) - 1, min(len(starts), most)).astype(int)) if starts else ()
    return [starts[index] for index in chosen]


def _list_starts(motion: RecordedMotion, horizons: tuple[float, ...]) -> list[int]:
    """Return samples that simulations may start from, spread over the motion; the longest horizon fits if it can."""
    t = motion.reference.t
    length = float(t[-1] - t[0])
    # A segment that is too short for the longest horizon still serves the shorter ones.
    last = length - horizons[-1] if length > horizons[-1] else length - horizons[0]
    if last < 0:
        return []
    times = np.linspace(0.0, last, int(last / _APART) + 1) + t[0]
    # The sample before, so that the horizon still fits behind it; a sample's time may be off by rounding.
    return [int(k) for k in np.searchsorted(t, times + 1e-9, side="right") - 1]


def _simulate_without_control(
    simulator: Simulator, starts: Sequence[tuple[RecordedMotion, int]], horizons: tuple[float, ...], progress: Progress
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how far simulated robots are off in position and velocity, and how far the real one moved: (k, h, n)."""
    robot, signals = simulator.robot, simulator.robot.dynamics.signals
    # A sample's time may be off by rounding; a horizon that ends there is there.
    counts = [
        int(np.count_nonzero(motion.reference.t[start] + np.array(horizons) <= motion.reference.t[-1] + 1e-9))
        for motion, start in starts
    ]
    rows = np.rint(np.array(horizons[: max(counts)]) / _STEP).astype(np.intp)
    after = _STEP * np.arange(rows[-1] + 1)
    references, memories = [], []
    torque = np.empty((len(after), len(starts), robot.robot.n))
    measured = np.full((3, len(starts), len(horizons), robot.robot.n), np.nan)
    for k, ((motion, start), count) in enumerate(zip(starts, counts, strict=True)):
        whole = motion.reference
        t = whole.t[start] + after
        # Beyond the end of a motion the last torque is held; what is simulated there is not used.
        torque[:, k] = _interpolate(t, whole.t, motion.tau)
        heat = None if whole.temperature is None else whole.temperature[start:]
        references.append(
            replace(
                whole,
                t=whole.t[start:],
                q=whole.q[start:],
                dq=whole.dq[start:],
                ddq=whole.ddq[start:],
                temperature=heat,
            )
        )
        # Presliding friction and backlash depend on the path before the start, so their states are carried along up to
        # it.
        memories.append(MemoryStates(signals.memory_signals).push(signals.robot.positions(whole.q[: start + 1]))[-1])
        q, dq = (_interpolate(t[rows[:count]], whole.t, signal) for signal in (whole.q, whole.dq))
        measured[:, k, :count] = q, dq, q - whole.q[start]
    with np.errstate(all="ignore"):
        q, dq = robot.move_freely(
            references,
            torque,
            _STEP,
            memory=np.array(memories),
            runs=[motion.label for motion, _ in starts],
            returned=rows,
            progress=progress,
        )
        off = np.stack([q, dq]).swapaxes(1, 2) - measured[:2, :, : len(rows)]
    # A state that is no number has diverged: infinitely far, and not missing.
    differences = np.full_like(measured[:2], np.nan)
    differences[:, :, : len(rows)] = np.where(
        np.isnan(measured[:2, :, : len(rows)]), np.nan, np.nan_to_num(off, nan=np.inf)
    )
    return differences[0], differences[1], measured[2]


def _interpolate(t: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (m, n), which are known at some times, at other times."""
    return np.column_stack([np.interp(t, known, column) for column in values.T])


def _compute_rms(values: FloatArray) -> FloatArray:
    """Return the root mean square (h, n) over the starts (k, h, n) that reach so far; nan where none does."""
    there = ~np.isnan(values)
    counts = there.sum(axis=0)
    with np.errstate(over="ignore"):
        squares = np.where(there, values, 0.0) ** 2
        return np.where(counts > 0, np.sqrt(squares.sum(axis=0) / np.maximum(counts, 1)), np.nan)


@dataclass(frozen=True, eq=False)
class DriftValidation:
    """Drift of an open-loop simulation over recordings, with the verdict.

    Parameters
    ----------
    drift : Drift or None
        The drift; None where no robot can have the identified parameters, or the torque of a joint is unknown.
    judged : ValidationOutcome
        Whether the drift is small enough for a simulation, and the reason.
    """

    drift: Drift | None
    judged: ValidationOutcome


def validate_drift(
    identification: Identification,
    recordings: Sequence[Recording],
    horizons: Sequence[float] = HORIZONS,
    progress: Progress = ignore_progress,
) -> DriftValidation:
    """Start the simulated robot from many measured states and judge how far it drifts under the measured torque.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Recordings of the same robot, held out as a rule.
    horizons : sequence of float
        Seconds of simulation after which the drift is given.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    DriftValidation
        The drift, judged until half a second by its share of the travel.

    Raises
    ------
    DynidentError
        Where the recordings have no motion of the shortest horizon.
    """
    # Before the simulation: negative friction or inertia would make it diverge without saying why.
    possible = make_physical(identification)
    if not possible.is_possible:
        return DriftValidation(None, ValidationOutcome("fail", describe_impossible(possible)))
    unknown = find_unknown_torque(identification, recordings)
    if unknown:
        return DriftValidation(None, ValidationOutcome("not_evaluated", describe_unknown_torque(unknown)))
    drift = compute_open_loop_drift(possible.identification, recordings, horizons, progress)
    return DriftValidation(drift, judge_drift(drift).prepend_reason(possible.note))


def describe_impossible(possible: PhysicalModel) -> str:
    """Describe why a model cannot be simulated at all, in a sentence."""
    return f"No physical robot can have the identified parameters: {'; '.join(possible.impossible)}."


def judge_drift(drift: Drift) -> ValidationOutcome:
    """Judge a drift by its share of the travel until half a second."""
    if np.isnan(drift.worst_share):
        reason = f"No segment of the recordings is {drift.judged_until:g} s long."
        return ValidationOutcome("not_evaluated", reason)
    if not drift.worst_share <= LARGEST_DRIFT:
        until = "half a second" if drift.judged_until == _JUDGED_UNTIL else f"{drift.judged_until:g} s"
        complaint = (
            f"More than {format_percent(LARGEST_DRIFT, decimals=0)} of the travel within {until} is too much for "
            "a simulation."
        )
        return ValidationOutcome("fail", f"{drift.describe()} {complaint}")
    return ValidationOutcome("pass", drift.describe())
