"""Fit torque by smooth functions of the motion, without a robot model: sign, ownership and delay of each torque.

Used by the torque checks.

Each joint's torque is explained by smooth functions of all positions (gravity), all accelerations (inertia) and the
friction of its own joint. It is no model to predict with; it is enough to see a torque that belongs to another joint,
has the wrong sign, or comes late.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.errors import DynidentError
from dynident.recordings.joint_phases import Phase, Phases, find_phases
from dynident.recordings.low_pass_decimation import FilteredRows, ParallelFilter
from dynident.recordings.position_filter import filtered_blocks
from dynident.recordings.preprocessing import Preprocessing, choose_preprocessing
from dynident.recordings.recording import Recording, SampleBlock, Segment

MAX_ROWS = 10_000
"""Decimated rows to look at, from intervals evenly spread over the recording."""

INTERVALS = 8
BLOCKS = 12
"""Blocks of time for the jackknife: neighbouring rows are not independent."""

ROWS_PER_COLUMN = 8
SPAN = 0.2
"""Largest misalignment that is looked for, in s."""

EXPLAINED = 0.9
"""Share of a torque's variance that the motion has to explain before its alignment says anything."""

_HELD = 0.02
"""Share of what is under the filter at which a joint stands, from which on its friction is not known."""

_RANK = 1e-10


class Shiftable(NamedTuple):
    """One contiguous part of the torque, which can be read at other times than those of its rows.

    Parameters
    ----------
    torque : scipy.interpolate.CubicSpline
        Torques of all joints over time.
    t : (m,)
        Times of its rows in s.
    """

    torque: scipy.interpolate.CubicSpline
    t: FloatArray


@dataclass(frozen=True, eq=False)
class TorqueEvidence:
    """Decimated rows of motion and torque, in the order of time.

    Parameters
    ----------
    smooth : (r, k)
        Functions of the motion that are smooth: 1, sines and cosines of q, products of neighbours', those of the sum of
        three angles, and last q̈ (n columns).
    friction : (r, n, 3)
        Of each joint the velocity, a rounded sign of it, and the sign.
    tau : (r, n)
        Torques in N m, or forces in N.
    steady : (r, n) of bool
        True clear of a joint's reversals.
    held : (r, n) of bool
        True where a joint stands, so that its friction has no sign.
    block : (r,) of int
        Number of the block of time that the row belongs to, for the jackknife.
    moving : (n,) of bool
        Joints that move at all.
    series : tuple of Shiftable
        Torque of the same rows at other times.
    resolution : float
        Step in s that tells such shifts apart.
    """

    smooth: FloatArray
    friction: FloatArray
    tau: FloatArray
    steady: BoolArray
    held: BoolArray
    block: IntArray
    moving: BoolArray
    series: tuple[Shiftable, ...]
    resolution: float


class Direction(NamedTuple):
    """How a joint's torque goes with its own motion; both figures are positive in every machine.

    Parameters
    ----------
    friction : float
        Power that its own friction takes, over its standard error.
    inertia : float
        Slope of its torque against its own acceleration, over its standard error.
    """

    friction: float
    inertia: float


class Lag(NamedTuple):
    """How late all torques are against the motion.

    Parameters
    ----------
    seconds : float
        Time in s by which they are late; negative: early.
    error : float
        Its standard error in s.
    gain : float
        Share by which the squared residual falls at this shift.
    """

    seconds: float
    error: float
    gain: float


def gather_evidence(recording: Recording) -> TorqueEvidence | None:
    """Collect the rows to fit.

    Parameters
    ----------
    recording : Recording
        The checked recording.

    Returns
    -------
    TorqueEvidence or None
        None if the recording is too short, or moves too little, to say anything.
    """
    try:
        choice = choose_preprocessing([recording])
    except DynidentError:
        return None
    # Parts from all over a long recording show as much as all of it, in bounded time and memory.
    excerpt = shorten_recording(recording, choice.decimation)
    blocks = [block for block in filtered_blocks(excerpt, choice) if block.used.any()]
    if not blocks:
        return None
    speed = _compute_rms_speed(blocks)
    moving: BoolArray = speed > 1e-3 * speed.max()
    if not moving.any():
        return None
    # The sign of a velocity is rounded over a tenth of the joint's rms speed. Time is resolved in 6 % of the shortest
    # period that the filter lets through.
    runs = _filter_blocks(blocks, np.maximum(0.1 * speed, 1e-12), find_phases(excerpt), recording.sampling_rate, choice)
    evidence = _arrange_evidence(runs, recording.n, moving, 0.06 / (choice.torque_cutoff or 5.0)) if runs else None
    # A fit with hardly more rows than columns explains any torque.
    if evidence is None or len(evidence.tau) < ROWS_PER_COLUMN * evidence.smooth.shape[1]:
        return None
    return evidence


def measure_direction(evidence: TorqueEvidence, joint: int) -> Direction:
    """Return whether a joint's torque goes with its motion or against it.

    Parameters
    ----------
    evidence : TorqueEvidence
        Decimated rows of motion and torque.
    joint : int
        Index of the joint.

    Returns
    -------
    Direction
        (0, 0) if the joint moves too little to tell.
    """
    n = evidence.tau.shape[1]
    moving_rows = ~evidence.held[:, joint]
    if moving_rows.sum() < ROWS_PER_COLUMN * evidence.smooth.shape[1]:
        return Direction(0.0, 0.0)
    own = evidence.smooth.shape[1] - n + joint
    friction, smooth = evidence.friction[moving_rows, joint], evidence.smooth[moving_rows]
    # Own inertia and friction are kept as columns: their weights are looked at, those of all others are not.
    others = orthonormalise(np.delete(smooth, own, axis=1))
    columns = np.column_stack([others, smooth[:, own], friction])
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    weights = [
        w / scale
        for w in _solve_jackknife(
            columns / scale, evidence.tau[moving_rows, joint], _number_blocks(int(moving_rows.sum()))
        )
    ]
    # The mean of velocity times friction torque: its sign holds whatever the shape of the friction law.
    power = [float(np.mean(friction[:, 0] * (friction @ w[-3:]))) for w in weights]
    inertia = [float(w[-4]) for w in weights]
    return Direction(_divide_by_error(power), _divide_by_error(inertia))


def measure_ownership(evidence: TorqueEvidence) -> FloatArray:
    """Return how much of each torque the friction of each joint explains.

    Friction is here q̇ and its rounded sign: a sharper sign would follow reversals that the other columns miss.
    A share counts only where it dissipates: friction that drives its joint is no friction.

    Parameters
    ----------
    evidence : TorqueEvidence
        Decimated rows of motion and torque.

    Returns
    -------
    (n, n)
        Share of torque i's variance that the friction of joint j explains beside gravity and inertia.
    """
    n = evidence.tau.shape[1]
    shares = np.zeros((n, n))
    basis = orthonormalise(evidence.smooth)
    # An orthonormal basis makes the projection two products, for all torques at once.
    unexplained = evidence.tau - basis @ (basis.T @ evidence.tau)
    variance = np.maximum(((evidence.tau - evidence.tau.mean(axis=0)) ** 2).sum(axis=0), 1e-300)
    for j in np.flatnonzero(evidence.moving):
        own = evidence.friction[:, j, :2]
        # What gravity and inertia can explain is taken out of friction, too: only the rest of it is evidence.
        own_friction = own - basis @ (basis.T @ own)
        weights = np.linalg.lstsq(own_friction, unexplained, rcond=1e-9)[0]
        # The power of the friction torque, summed over all rows: friction takes energy out of the motion.
        dissipates = own[:, 0] @ (own @ weights) > 0.0
        shares[:, j] = np.where(dissipates, ((own_friction @ weights) ** 2).sum(axis=0) / variance, 0.0)
    return shares


def measure_lag(evidence: TorqueEvidence, *, steady_only: bool) -> Lag | None:
    """Find the common shift of all torques that the motion explains best.

    Parameters
    ----------
    evidence : TorqueEvidence
        Decimated rows of motion and torque.
    steady_only : bool
        Whether rows around reversals are left out: there presliding looks like lateness.

    Returns
    -------
    Lag or None
        None if the shift cannot be told.
    """
    count = round(SPAN / evidence.resolution)
    shifts = evidence.resolution * np.arange(-count, count + 1, dtype=np.float64)
    curves = np.zeros((BLOCKS, len(shifts)))
    n_counting = 0
    for joint in np.flatnonzero(evidence.moving):
        rows = evidence.steady[:, joint] if steady_only else np.ones(len(evidence.tau), dtype=bool)
        if rows.sum() < ROWS_PER_COLUMN * evidence.smooth.shape[1]:
            continue
        # The motion's columns stay in place and the torque is shifted: one basis then serves all shifts.
        columns = orthonormalise(np.column_stack([evidence.smooth, evidence.friction[:, joint]])[rows])
        shifted = _evaluate_at_shifts(evidence, int(joint), shifts)[rows]
        residual = shifted - columns @ (columns.T @ shifted)
        spread = shifted - shifted.mean(axis=0)
        # A torque that the motion explains at no shift says nothing of its alignment.
        if (residual**2).sum(axis=0).min() > (1.0 - EXPLAINED) * (spread**2).sum(axis=0).mean():
            continue
        errors = np.zeros_like(curves)
        # Squared errors by block of time, so that the jackknife can leave one out below.
        np.add.at(errors, evidence.block[rows], residual**2)
        # Every joint counts in units of its own noise.
        n_counting += 1
        curves += errors / max(float(errors.sum(axis=0).min()), 1e-300)
    total = curves.sum(axis=0)
    at = int(total.argmin())
    # One joint alone may be late by its presliding; a log that is late is so for all.
    if n_counting < 2 or at in (0, len(shifts) - 1):
        return None
    minima = [_find_minimum(total - curves[block], shifts) for block in range(BLOCKS)]
    # The middle one of the shifts is none: the gain is measured against the log as it is.
    gain = 1.0 - float(total.min()) / max(float(total[len(shifts) // 2]), 1e-300)
    return Lag(_find_minimum(total, shifts), _jackknife_error(minima), gain)


def orthonormalise(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the columns' span.

    Parameters
    ----------
    columns : (r, k)
        Columns of any size, none of which need be independent of the others.

    Returns
    -------
    (r, rank)
        Directions of rounding error are left out.
    """
    norms = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(norms > 0, norms, 1.0)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    is_kept = values > _RANK * values[-1]
    # Once more by QR: the Gram matrix squares the condition number.
    basis: FloatArray = np.linalg.qr(scaled @ (vectors[:, is_kept] / np.sqrt(values[is_kept])))[0]
    return basis


def shorten_recording(recording: Recording, decimation: int) -> Recording:
    """Return a long recording cut down to evenly spread parts.

    Parameters
    ----------
    recording : Recording
        The checked recording.
    decimation : int
        Every how many-th row is kept later on: so many times more rows are allowed.

    Returns
    -------
    Recording
        The same recording if it is short enough, else one with shorter segments.
    """
    allowed = MAX_ROWS * decimation
    if recording.n_samples <= allowed:
        return recording
    length = allowed // INTERVALS
    share = recording.n_samples / INTERVALS
    segments: list[Segment] = []
    for segment in recording.segments:
        pieces = max(1, round(segment.length / share))
        starts = np.linspace(0, max(0, segment.length - length), pieces).astype(int)
        segments += [_cut_segment(segment, int(start), length, recording.period) for start in starts]
    return replace(recording, segments=tuple(segments))


def _cut_segment(segment: Segment, start: int, length: int, period: float) -> Segment:
    return Segment(
        first_row=segment.first_row + start,
        length=min(length, segment.length - start),
        start_time=segment.start_time + start * period,
        label=segment.label,
    )


def _compute_rms_speed(blocks: list[SampleBlock]) -> FloatArray:
    total = np.sum([(block.dq[block.used] ** 2).sum(axis=0) for block in blocks], axis=0)
    speed: FloatArray = np.sqrt(total / sum(int(block.used.sum()) for block in blocks))
    return speed


def _build_columns(block: SampleBlock, rounding: FloatArray, phases: Phases) -> FloatArray:
    """Return the unfiltered columns: functions of q, q̈, q̇, rounded signs, marks of reversals and rest, τ."""
    n = block.q.shape[1]
    shapes = np.sin(block.q), np.cos(block.q)
    neighbours = [a[:, i] * b[:, i + 1] for i in range(n - 1) for a, b in product(shapes, shapes)]
    # Three parallel axes in a row carry gravity by the sum of their angles.
    level = block.q[:, :-2] + block.q[:, 1:-1] + block.q[:, 2:] if n > 2 else block.q[:, :0]
    reversal = np.zeros_like(block.dq)
    reversal[1:] = np.diff(np.sign(block.dq), axis=0) != 0
    signs = np.tanh(block.dq / rounding), np.sign(block.dq)
    smooth = [np.ones(len(block.t)), *shapes, *neighbours, np.sin(level), np.cos(level)]
    rests = phases.phases_at(block.segment, block.t, 0.0) == Phase.STANDING
    return np.column_stack([*smooth, block.ddq, block.dq, *signs, reversal, rests, block.tau])


def _filter_blocks(
    blocks: list[SampleBlock], rounding: FloatArray, phases: Phases, rate: float, choice: Preprocessing
) -> list[FilteredRows]:
    """Filter and decimate; one result for each contiguous series of blocks."""
    parallel = ParallelFilter(rate, choice.torque_cutoff, choice.decimation)
    runs: list[FilteredRows] = []
    parts: list[FilteredRows] = []

    def close_run() -> None:
        parts.append(parallel.flush())
        run = FilteredRows(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
        # A shorter run has no row that could be shifted by the whole span in both directions.
        if len(run.t) > 8 and run.t[-1] - run.t[0] > 2.0 * SPAN:
            runs.append(run)
        parts.clear()

    previous: SampleBlock | None = None
    for block in blocks:
        if previous is not None and (block.segment != previous.segment or block.t[0] > previous.t[-1] + 1.5 / rate):
            close_run()
        parts.append(parallel.push(_build_columns(block, rounding, phases), block.t, block.used))
        previous = block
    close_run()
    return runs


def _arrange_evidence(runs: list[FilteredRows], n: int, moving: BoolArray, resolution: float) -> TorqueEvidence:
    """Return the evidence in filtered rows; the ends, at which torque could not be shifted, are left out."""
    inside = [run.used & (run.t >= run.t[0] + SPAN) & (run.t <= run.t[-1] - SPAN) for run in runs]
    values = np.concatenate([run.values[keep] for run, keep in zip(runs, inside, strict=True)])
    series = [
        Shiftable(scipy.interpolate.CubicSpline(r.t, r.values[:, -n:]), r.t[keep])
        for r, keep in zip(runs, inside, strict=True)
    ]
    # The last six groups of n columns, in the order of `_build_columns`; q̈ stays with the smooth ones.
    borders = values.shape[1] - n * np.array([6, 5, 4, 3, 2, 1])
    smooth, speed, rounded, sign, reversal, rests, tau = np.split(values, borders, axis=1)
    return TorqueEvidence(
        smooth=smooth,
        friction=np.stack([speed, rounded, sign], axis=2),
        tau=tau,
        # The low-passed mark of a reversal is far from 0 only within about a period of the cut-off around it.
        steady=np.abs(reversal) < 1e-3,
        held=np.abs(rests) > _HELD,
        block=_number_blocks(len(values)),
        moving=moving,
        series=tuple(series),
        resolution=resolution,
    )


def _number_blocks(count: int) -> IntArray:
    """Return (count,): blocks of time of so many rows, equally many each."""
    return np.arange(count) * BLOCKS // max(count, 1)


def _evaluate_at_shifts(evidence: TorqueEvidence, joint: int, shifts: FloatArray) -> FloatArray:
    """Return a joint's torque at its rows' times plus every shift (r, len(shifts))."""
    parts = []
    for run in evidence.series:
        own = scipy.interpolate.CubicSpline.construct_fast(run.torque.c[:, :, joint], run.torque.x)
        parts.append(own(run.t[:, None] + shifts))
    return np.concatenate(parts)


def _solve_jackknife(columns: FloatArray, tau: FloatArray, block: IntArray) -> list[FloatArray]:
    """Return the least-squares weights of all rows, then those without each block; columns are of unit length."""
    columns, tau = _weigh_rows(columns, tau)
    parts = [block == index for index in range(BLOCKS)]
    grams = np.array([columns[part].T @ columns[part] for part in parts])
    sides = np.array([columns[part].T @ tau[part] for part in parts])
    # A small ridge keeps the normal equations solvable when a block is left out.
    gram, side = grams.sum(axis=0) + 1e-9 * np.eye(columns.shape[1]), sides.sum(axis=0)
    # Normal equations add up over blocks of rows: leaving one out is a subtraction instead of another fit.
    without = [np.linalg.solve(gram - g, side - s) for g, s in zip(grams, sides, strict=True)]
    return [np.linalg.solve(gram, side), *without]


def _weigh_rows(columns: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weigh the rows so that a contact, or a time in stiction, does not decide (Huber's weights)."""
    weight = np.ones(len(tau))
    for _ in range(4):
        solved = np.linalg.lstsq(columns * weight[:, None], tau * weight, rcond=1e-7)[0]
        off = np.abs(tau - columns @ solved)
        # Twice the median residual is 1.35 standard deviations of normal noise, where Huber's weights usually begin to
        # fall. Rows carry the square root of their weight.
        weight = np.sqrt(1.0 / np.maximum(1.0, off / max(2.0 * float(np.median(off)), 1e-300)))
    return columns * weight[:, None], tau * weight


def _divide_by_error(values: list[float]) -> float:
    """Return the first value over the jackknife error of the others."""
    return values[0] / max(_jackknife_error(values[1:]), 1e-300)


def _jackknife_error(values: list[float]) -> float:
    spread = np.asarray(values) - np.mean(values)
    # Leaving out one of many blocks changes an estimate little: this factor makes a standard error of such changes.
    return float(np.sqrt((len(values) - 1) / len(values) * (spread**2).sum()))


def _find_minimum(curve: FloatArray, at: FloatArray) -> float:
    """Return the lowest point of a sampled curve, by a parabola."""
    index = int(np.clip(curve.argmin(), 1, len(curve) - 2))
    before, middle, after = curve[index - 1 : index + 2]
    bend = before - 2.0 * middle + after
    offset = 0.5 * (before - after) / bend if bend > 0 else 0.0
    return float(at[index] + (at[1] - at[0]) * np.clip(offset, -1.0, 1.0))
