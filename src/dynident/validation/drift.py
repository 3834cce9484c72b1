"""How far a simulated robot drifts from the recorded one under the measured torque, without a controller.

A simulator that follows a recorded motion under joint control hides what its model lacks: the controller makes up for
it. Started from a measured state under the measured torque alone, the error of the torque becomes one of the position.
Most arms are unstable then (a link that stands upright falls to either side), so only short times are simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.blas_threads import single_threaded
from dynident.effects.hysteresis_states import MemoryStates
from dynident.errors import DynidentError
from dynident.identification import Identification
from dynident.identification.estimators.reference_motion import RecordedMotion, read_longest_piece
from dynident.identification.estimators.simulator import Simulator, build_simulator
from dynident.recordings import Recording
from dynident.recordings.phases import STANDS

AFTER = (0.1, 0.5, 2.0)
"""Seconds: a few samples of a controller, a quick move, and a whole motion from point to point."""

# Step of the integration in s.
_STEP = 1e-3
# Seconds between starts: closer ones tell the same again.
_APART = 0.5
# Starts over all recordings: a mean over more of them hardly changes, and each costs a simulation.
_MOST_STARTS = 60


@dataclass(frozen=True, eq=False)
class Drift:
    """How far a simulated robot drifts from the recorded one under the measured torque.

    Infinite where the simulation diverged, nan where no segment of the recordings is that long.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the joints.
    distance : (3, n)
        Root mean square distance of the simulated from the recorded positions after `AFTER` s, in rad or m.
    way : (3, n)
        Root mean square of how far the joints moved meanwhile, in rad or m.
    starts : int
        Number of states that simulations were started from.
    """

    joint_names: tuple[str, ...]
    distance: FloatArray
    way: FloatArray
    starts: int

    @property
    def after(self) -> tuple[float, ...]:
        """Seconds of simulation after which the drift is given."""
        return AFTER

    @property
    def share(self) -> FloatArray:
        """Distance over way (3, n). For a joint that hardly moves, over what a standing joint may move."""
        return np.asarray(self.distance / np.maximum(self.way, STANDS))


@single_threaded
def compute_open_loop_drift(identification: Identification, recordings: Sequence[Recording]) -> Drift:
    """Simulate a robot with the identified parameters, without a controller, from many states of recorded motions.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Recordings of the same robot, held out as a rule.

    Returns
    -------
    Drift
        Distances after each of `AFTER`, over all starts.

    Raises
    ------
    DynidentError
        Where no robot can have the identified parameters, or no recording has a motion to follow.
    """
    # Built once for all starts: its equation of motion does not change.
    simulator = build_simulator(identification.model, identification.values)
    motions = [read_longest_piece(recording, identification.preprocessing, np.inf) for recording in recordings]
    each = max(1, _MOST_STARTS // max(len(motions), 1))
    outcomes = [
        _simulate_without_control(simulator, motion, start)
        for motion in motions
        for start in _choose_starts(motion, each)
    ]
    if not outcomes:
        raise DynidentError(
            f"no unbroken stretch of the recordings is {AFTER[0]:g} s long", pointer="/windows", title="Too short"
        )
    away, moved = (np.array(distances) for distances in zip(*outcomes, strict=True))
    return Drift(identification.model.robot.joint_names, _compute_rms(away), _compute_rms(moved), len(outcomes))


def _choose_starts(motion: RecordedMotion, most: int) -> list[int]:
    """Return the samples that simulations start from, spread over the motion; the longest horizon fits where it can."""
    t = motion.reference.t
    length = float(t[-1] - t[0])
    # A segment that is too short for the longest horizon still serves the shorter ones.
    last = length - AFTER[-1] if length > AFTER[-1] else length - AFTER[0]
    if last < 0:
        return []
    times = np.linspace(0.0, last, min(most, int(last / _APART) + 1)) + t[0]
    return [int(k) for k in np.searchsorted(t, times - 1e-9)]


def _simulate_without_control(
    simulator: Simulator, motion: RecordedMotion, start: int
) -> tuple[FloatArray, FloatArray]:
    """Return how far the simulated robot is off, and how far the real one moved: (3, n) each."""
    whole, robot = motion.reference, simulator.robot
    n = whole.q.shape[1]
    here = whole.t[start]
    # A sample's time may be off by rounding; a horizon that ends there is there.
    after = np.array([horizon for horizon in AFTER if here + horizon <= whole.t[-1] + 1e-9])
    t = here + _STEP * np.arange(round(after[-1] / _STEP) + 1)
    tau = np.column_stack([np.interp(t, whole.t, column) for column in motion.tau.T])
    heat = None if whole.temperature is None else whole.temperature[start:]
    rest = replace(
        whole, t=whole.t[start:], q=whole.q[start:], dq=whole.dq[start:], ddq=whole.ddq[start:], temperature=heat
    )
    signals = robot.dynamics.signals
    # Presliding friction and backlash depend on the path before the start, so their states are carried along up to it.
    memory = MemoryStates(signals.memory_signals).push(signals.robot.positions(whole.q[: start + 1]))[-1]
    # A simulation that diverges overflows. That is a result, infinite drift, and no error.
    with np.errstate(all="ignore"):
        q = robot.move_freely(rest, tau, _STEP, memory=memory, run=motion.label)
    rows = np.rint(after / _STEP).astype(np.intp)
    measured = np.column_stack([np.interp(t[rows], whole.t, column) for column in whole.q.T])
    away, way = np.full((len(AFTER), n), np.nan), np.full((len(AFTER), n), np.nan)
    # A state that is no number has diverged: infinitely far, and not missing.
    away[: len(after)] = np.nan_to_num(np.abs(q[rows] - measured), nan=np.inf)
    way[: len(after)] = np.abs(measured - whole.q[start])
    return away, way


def _compute_rms(values: FloatArray) -> FloatArray:
    """Return the root mean square (3, n) over the starts (k, 3, n) that reach so far; nan where none does."""
    # Infinite distances stay in the mean, so that one diverged start shows.
    there = ~np.isnan(values)
    counts = there.sum(axis=0)
    squares = np.where(there, values, 0.0) ** 2
    return np.where(counts > 0, np.sqrt(squares.sum(axis=0) / np.maximum(counts, 1)), np.nan)
