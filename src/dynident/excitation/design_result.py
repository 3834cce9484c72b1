"""The result of a design (runs, margins, notes), clearances along its motion, and the recording that it will have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from dynident.array_types import FloatArray, IntArray
from dynident.errors import KnownNames
from dynident.excitation.criteria.optimality_criteria import Baseline, CriterionValues
from dynident.excitation.criteria.parameter_variances import ExpectedParameter
from dynident.excitation.design_request import DesignRequest
from dynident.excitation.standing_feet import stand_on_feet
from dynident.motion.collision.exact_distances import Nearest
from dynident.motion.limits.bounds import build_bounds
from dynident.motion.limits.limit_margins import Margin
from dynident.recordings import Recording, recording_from_arrays
from dynident.recordings.joint_phases import find_phases
from dynident.recordings.row_storage import load_stored_samples
from dynident.robot.robot_model import Robot

_PLANNED_SAMPLES = 2000
# Speeds are differences of positions at most so many seconds before and after: less is noise of the positions. For fast
# motions it is the time 1 / ω in which the speed of a joint changes, so that no difference is one of another swing.
_SPEED_SPAN = 0.05
# Share of its reversals at which a joint has to stick to be expected to stick: one that lingers by itself at some slow
# reversals seems to stick there, and does not at fast ones.
_MOST = 0.75
# A recording follows a planned motion where so many of its postures are within this share of each joint's travel of a
# planned one, and where the travel of each joint and the median of their speeds are at least this part of the planned.
# Joints with less travel than the fourth (rad or m) stand; samples above the fifth part of the top speed move.
_ON_PATH, _NEAR, _LEAST_PART, _STANDS, _MOVES = 0.9, 0.1, 0.7, 1e-3, 0.05


def find_nearest_along(
    robot: Robot, request: DesignRequest, q: FloatArray, mesh_folders: Sequence[Path] = ()
) -> tuple[Nearest, ...]:
    """Return for every body that a design keeps clear what it is nearest to at postures q.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    request : DesignRequest
        The design request, with its limits and surroundings.
    q : (m, n)
        Postures along the motion, rad or m.
    mesh_folders : sequence of Path
        Folders of the description's meshes.

    Returns
    -------
    tuple of Nearest
        For each body, what it is nearest to; empty where nothing is kept clear of, and where the trunk sways, as the
        joints alone do not say where it is.

    Raises
    ------
    DynidentError
        Where the request does not fit the robot.
    """
    around = replace(request.surroundings, mesh_folders=tuple(map(str, mesh_folders)))
    robot, request, balance = stand_on_feet(robot, replace(request, surroundings=around))
    if balance is not None and balance.sway is not None:
        return ()
    space = build_bounds(
        robot,
        request.limits,
        torque_margin=request.torque_margin,
        surroundings=request.surroundings,
        balance=balance,
    ).space
    return () if space is None or space.contacts is None else tuple(space.contacts.find_nearest(q))


# Difference of times (s) that is rounding.
_HAIR = 1e-9


@dataclass(frozen=True)
class Run:
    """One test motion of a set.

    Parameters
    ----------
    label : str
        Purpose of the test motion, in words.
    joints : tuple of str
        Names of the joints that move.
    start : float
        Start in the experiment, s.
    end : float
        End in the experiment, s.
    """

    label: str
    joints: tuple[str, ...]
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class Design(KnownNames):
    """A verified experiment: samples at the sampling rate, from home to home.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the n joints.
    request : DesignRequest
        The request that it answers.
    t : (N,)
        Times, s.
    q, dq, ddq : (N, n)
        Positions, velocities and accelerations: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).
    exciting : tuple of (float, float)
        Times between which the exciting part lies, s.
    period : float or None
        Period of the exciting part, s; None where it has none.
    parameter_names : tuple of str
        Base parameters that it was designed for.
    criterion_values : CriterionValues
        Values of the exciting part by all criteria.
    baseline : Baseline or None
        What random trajectories reach; None where there is nothing to compare.
    margins : tuple of Margin
        How near every limit comes, on a grid ten times as fine.
    notes : tuple of str
        Notes for the user: what was assumed, changed, or not checked.
    expected : tuple of ExpectedParameter
        Expected uncertainty of each parameter.
    runs : tuple of Run
        The test motions of a set, one after the other.
    floor : float or None
        Height in the base frame, m, of the floor that the motion was checked against, stated or assumed; None where
        there was none.
    warnings : tuple of str
        The notes that one must have read before running the motion: what was not checked.
    """

    joint_names: tuple[str, ...]
    request: DesignRequest
    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    exciting: tuple[float, float]
    period: float | None
    parameter_names: tuple[str, ...]
    criterion_values: CriterionValues
    baseline: Baseline | None
    margins: tuple[Margin, ...]
    notes: tuple[str, ...]
    expected: tuple[ExpectedParameter, ...] = ()
    runs: tuple[Run, ...] = ()
    floor: float | None = None
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return (
            f"Design({self.request.kind}: {len(self.joint_names)} joints, {self.n_samples} samples at "
            f"{self.sampling_rate:g} Hz, {self.duration:.4g} s, condition number "
            f"{self.criterion_values.condition_number:.4g})"
        )

    @property
    def n_samples(self) -> int:
        """Number of samples N."""
        return len(self.t)

    @property
    def segments(self) -> IntArray:
        """Number (N,) of the run that a sample belongs to, from 1 on; 0 outside of all runs."""
        number = np.zeros(len(self.t), dtype=np.int64)
        for index, run in enumerate(self.runs):
            # Times of samples and ends of runs are sums of the same numbers in another order, which rounds differently.
            number[(self.t >= run.start - _HAIR) & (self.t <= run.end + _HAIR)] = index + 1
        return number

    @property
    def sampling_rate(self) -> float:
        """Sampling rate, Hz."""
        return self.request.trajectory.sampling_rate

    @property
    def duration(self) -> float:
        """Time from home to home, s."""
        return float(self.t[-1])

    @property
    def moves(self) -> float:
        """Time of the moves from and to home, s."""
        return self.duration - (self.exciting[1] - self.exciting[0])


def expect_recording(design: Design, last: Recording) -> Recording:
    """Return the recording that a motion will have, without torque.

    A joint that stuck at nearly all of its reversals in the last recording will stick again, until the plan is as far
    ahead of it as it was there: a controller overcomes friction by the error of the position. The faster the joint
    reverses, the sooner that is.

    Parameters
    ----------
    design : Design
        The planned motion.
    last : Recording
        A recording of the same robot; the new one gets its sampling period and its name.

    Returns
    -------
    Recording
        Positions, and torques of zero.
    """
    t = np.arange(design.t[0], design.t[-1], last.period)
    planned, dq = (
        scipy.interpolate.CubicHermiteSpline(design.t, *pair)(t)
        for pair in ((design.q, design.dq), (design.dq, design.ddq))
    )
    q = planned.copy()
    for j, lag in enumerate(_measure_lags(last)):
        for k in np.flatnonzero(dq[:-1, j] * dq[1:, j] < 0) if lag > 0.0 else ():
            hold = int(np.argmax(np.abs(planned[k:, j] - planned[k, j]) > lag))
            # It holds its position, and catches up in as long a time.
            after = slice(k, k + 2 * hold)
            late = t[k] + np.maximum(0.0, 2 * (t[after] - t[k] - hold * last.period))
            q[after, j] = np.interp(late, t, planned[:, j])
    return recording_from_arrays(t, q, np.zeros_like(q), joint_names=last.joint_names, name=last.name)


def _measure_lags(recording: Recording) -> FloatArray:
    """Return how far each joint's plan is ahead (n,) when it breaks loose at a reversal, at most of its reversals."""
    positions, lags = _read_positions(recording), np.zeros(recording.n)
    for j, halts in enumerate(zip(*find_phases(recording).halts, strict=True)):
        own = []
        for each, segment in zip(halts, recording.segments, strict=True):
            first = np.rint((each.starts - segment.start_time) / recording.period).astype(int)
            rows = np.maximum(1, np.rint((each.ends - each.starts) / recording.period)).astype(int)
            is_inside = each.turns & (first >= 2 * rows)
            first, rows = first[is_inside] + segment.first_row, rows[is_inside]
            # Speed and acceleration as the joint comes in, from positions as long before as the halt lasts.
            near, before, far = (positions[first - k * rows, j] for k in range(3))
            time = rows * recording.period
            acceleration = np.abs(near - 2.0 * before + far) / time**2
            speed = np.abs(near - before) / time - 0.5 * acceleration * time
            # By the plan it would have stopped then, and have turned back since.
            stopping = np.divide(speed, acceleration, out=np.zeros(len(time)), where=acceleration > 0.0)
            lag = 0.5 * acceleration * np.clip(time - stopping, 0.0, time) ** 2
            own += np.where(each.sticks[is_inside], lag, 0.0).tolist()
        lags[j] = np.quantile(own, 1.0 - _MOST, method="lower") if own else 0.0
    return lags


def _read_positions(recording: Recording) -> FloatArray:
    columns = load_stored_samples(recording).columns
    return np.column_stack([columns[f"q_{name}"] for name in recording.joint_names])


def follows_design(recording: Recording, design: Design) -> bool:
    """Return whether a recording is of a planned motion, however late it begins; only then its promise counts.

    Parameters
    ----------
    recording : Recording
        The recording.
    design : Design
        The planned motion.
    """
    # Of all recorded rows: filters cut the ends of a short motion off, where its speed may be highest.
    positions = _read_positions(recording)
    # (1 / ω)² of each joint.
    times = np.full(recording.n, np.inf)
    power = np.mean(design.ddq**2, axis=0)
    np.divide(np.mean(design.dq**2, axis=0), power, out=times, where=power > 0.0)
    span = max(1, round(min(_SPEED_SPAN, float(np.sqrt(times.min()))) / recording.period))
    paths = [
        positions[segment.first_row : segment.first_row + segment.length]
        for segment in recording.segments
        if segment.length > 2 * span
    ]
    if not paths:
        return False
    q = np.concatenate([path[span:-span] for path in paths])
    dq = np.concatenate([path[2 * span :] - path[: -2 * span] for path in paths]) / (2 * span * recording.period)
    travel = np.maximum(np.ptp(design.q, axis=0), np.finfo(float).tiny)
    planned = design.q[:: max(1, len(design.q) // _PLANNED_SAMPLES)]
    tree = scipy.spatial.cKDTree(planned / travel)
    distances, _ = tree.query(q[:: max(1, len(q) // _PLANNED_SAMPLES)] / travel, p=np.inf)
    if np.mean(distances <= _NEAR) < _ON_PATH:
        return False
    # Differences smooth: the planned speeds are differences over the same time.
    time = span * recording.period
    inner = design.t[(design.t >= design.t[0] + time) & (design.t <= design.t[-1] - time)]
    path = scipy.interpolate.CubicHermiteSpline(design.t, design.q, design.dq)
    planned_dq = (path(inner + time) - path(inner - time)) / (2 * time)
    if not len(inner):
        return False
    # Of the samples that move alone: a recording may begin long before the motion.
    slowest = _MOVES * np.abs(planned_dq).max(axis=0)
    moved = travel > _STANDS
    if not moved.any():
        return True
    # Slower is slower on all joints; a single one may shake.
    speeds = _compute_moving_rms(dq, slowest) / _compute_moving_rms(planned_dq, slowest).clip(_STANDS)
    is_wide = np.ptp(positions, axis=0) >= _LEAST_PART * travel
    return bool(is_wide[moved].all() and np.median(speeds[moved]) >= _LEAST_PART)


def _compute_moving_rms(dq: FloatArray, slowest: FloatArray) -> FloatArray:
    """Return the rms speed (n,) of each joint's samples that are faster than `slowest` (n,)."""
    moves = np.abs(dq) > slowest
    return np.asarray(np.sqrt((moves * dq**2).sum(axis=0) / np.maximum(moves.sum(axis=0), 1)))
