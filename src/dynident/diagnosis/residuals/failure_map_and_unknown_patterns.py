"""The map of where the residual is largest, and dependences of the residual that no effect explains.

Holds the bins of the map, and when one or two variables are named.

Dependences are bin means over a variable, learnt on some blocks of time and tried on the others; of the residual itself
and, since friction changes sign with the direction, of the residual times the sign of the velocity.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.diagnosis.diagnosis_result import FailureSpot, UnknownPattern, Variable
from dynident.estimation.residual_errors import compute_t
from dynident.estimation.row_weights import estimate_robust_scale

# Bins of the map, and fewest rows for which a bin is looked at.
_MAP_BINS = 16
_FEWEST_IN_MAP_BIN = 20


def build_failure_map(comparisons: Sequence[Comparison]) -> tuple[FailureSpot, ...]:
    """Return, for every joint and variable, the bin where the residual is largest against the joint's own rms."""
    first = comparisons[0]
    spots = []
    for j, name in enumerate(first.joint_names):
        residual = np.concatenate([c.residual[:, j] for c in comparisons])
        rms = float(np.sqrt(np.mean(residual**2)))
        if rms == 0.0:
            continue
        revolute = first.units[j] == "N m"
        angle = "rad" if revolute else "m"
        for variable, values, unit in (
            ("position", np.concatenate([c.q[:, j] for c in comparisons]), angle),
            ("velocity", np.concatenate([c.dq[:, j] for c in comparisons]), f"{angle}/s"),
            ("load", np.concatenate([c.load[:, j] for c in comparisons]), first.units[j]),
            ("time", np.concatenate([c.t for c in comparisons]), "s"),
        ):
            spot = _find_worst_bin(residual, values, rms)
            if spot is not None:
                low, high, local_rms = spot
                spots.append(FailureSpot(name, variable, unit, low, high, local_rms, local_rms / rms))
    return tuple(sorted(spots, key=lambda spot: -spot.ratio))


def _find_worst_bin(residual: FloatArray, values: FloatArray, rms: float) -> tuple[float, float, float] | None:
    edges = _compute_edges(values)
    if edges is None:
        return None
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    counts = np.bincount(which, minlength=len(edges) - 1)
    squares = np.bincount(which, weights=residual**2, minlength=len(edges) - 1)
    local = np.where(counts >= _FEWEST_IN_MAP_BIN, np.sqrt(squares / np.maximum(counts, 1)), 0.0)
    k = int(np.argmax(local))
    return (float(edges[k]), float(edges[k + 1]), float(local[k])) if local[k] > rms else None


def _compute_edges(values: FloatArray) -> FloatArray | None:
    # Quantiles instead of the extremes: a few far values must not make all bins wide.
    low, high = np.quantile(values, [0.005, 0.995])
    if not high - low > 1e-9 * max(1.0, abs(low), abs(high)):
        return None
    return np.linspace(low, high, _MAP_BINS + 1)


# Bins over one variable, bins each over two, and fewest rows for which a bin has a mean.
_BINS, _COARSE_BINS, _FEWEST = 24, 10, 10
# A bin's mean of all other blocks is tried on every fifth.
_FOLDS = 5
# Share of the variance from which on a dependence is reported, and t of its gain over the blocks.
_SHARE, _T = 0.08, 4.2
# What shows in few blocks (a rough spot that is seldom passed) gains unevenly.
_LARGE, _T_OF_LARGE = 0.25, 2.0
# A variable is named beside the best one if it explains so much of what that explains.
_NEARLY = 0.7
# A joint that sticks for a moment is no burst.
_SHORTEST_BURST, _BURST_SHARE = 0.3, 0.4
# Two variables must explain so many times what one of them does alone.
_MORE_BY_TWO = 1.25
# Share of what a dependence explains that its cause has to explain, with one or two numbers instead of its many bins.
_OF_PATTERN = 0.7
# Times a drive's torque that another joint's has to contain: a coupling in a wrist is a ratio of its gears.
_LEAST_COUPLING = 0.1


@dataclass(frozen=True, eq=False)
class _PatternRows:
    """All recordings in a row: signals (m, n), time (m,), and the block that every row is in (m,)."""

    residual: FloatArray
    telling: BoolArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    load: FloatArray
    drive: FloatArray
    t: FloatArray
    row_block: IndexArray

    @cached_property
    def bins_by_joint(self) -> list[tuple[IndexArray, IndexArray, IndexArray]]:
        """Bins (m,) of each joint's position and velocity, and coarse bins of its position.

        Pairs of bins have to be coarse: ten by ten of them share the rows of all.
        """
        return [
            (_number_bins(q, _BINS), _number_bins(dq, _BINS), _number_bins(q, _COARSE_BINS))
            for q, dq in zip(self.q.T, self.dq.T, strict=True)
        ]

    @classmethod
    def from_comparisons(cls, comparisons: Sequence[Comparison]) -> _PatternRows:
        def concatenate_signal(name: str) -> FloatArray:
            return np.concatenate([getattr(c, name) for c in comparisons])

        return cls(
            residual=np.concatenate([c.counted_residual for c in comparisons]),
            telling=np.concatenate([c.counted_rows for c in comparisons]),
            q=concatenate_signal("q"),
            dq=concatenate_signal("dq"),
            ddq=concatenate_signal("ddq"),
            load=concatenate_signal("load"),
            # What the drive itself takes, such as friction: a link's load may be that of another parameter.
            drive=np.concatenate([c.predicted - c.load for c in comparisons]),
            t=concatenate_signal("t"),
            row_block=number_blocks(comparisons),
        )


def find_unknown_patterns(comparisons: Sequence[Comparison]) -> tuple[UnknownPattern, ...]:
    """Find dependences of the residual that are left, the largest share of the residual's variance first."""
    rows = _PatternRows.from_comparisons(comparisons)
    patterns: list[UnknownPattern] = []
    for j, name in enumerate(comparisons[0].joint_names):
        best: dict[Variable, float] = {}
        joint = _JointRows.from_rows(rows, j)
        for variable, bins in _yield_partitions(rows, j):
            share = _compute_held_out_share(joint, bins)
            # Two variables always explain somewhat more than one, which alone is no dependence on the second.
            if variable == "other_joints" and share < _MORE_BY_TWO * best.get("position", 0.0):
                continue
            # Several ways to sort the rows may stand for one variable: the best of them counts.
            best[variable] = max(best.get(variable, 0.0), share)
        most = max(best.values(), default=0.0)
        own = [UnknownPattern(name, v, share) for v, share in best.items() if share >= max(_SHARE, _NEARLY * most)]
        if own:
            cause = _find_cause(rows, joint, j, comparisons[0], most)
            patterns += [replace(pattern, cause=cause) if pattern.share == most else pattern for pattern in own]
    patterns += _find_burst_patterns(comparisons, {pattern.joint for pattern in patterns})
    return tuple(sorted(patterns, key=lambda pattern: -pattern.share))


@dataclass(frozen=True, eq=False)
class _JointRows:
    """The rows (m,) that tell of one joint: what bin means are taken of, the block of each row, and folds of blocks."""

    telling: BoolArray
    targets: tuple[FloatArray, ...]
    row_block: IndexArray
    fold: IndexArray

    @classmethod
    def from_rows(cls, rows: _PatternRows, j: int) -> _JointRows:
        telling = rows.telling[:, j]
        residual = rows.residual[telling, j]
        # The residual itself, and times the sign of the joint's direction.
        targets = residual, residual * np.sign(rows.dq[telling, j])
        return cls(telling, targets, rows.row_block[telling], np.arange(int(rows.row_block.max()) + 1) % _FOLDS)


def _yield_partitions(rows: _PatternRows, j: int) -> Iterator[tuple[Variable, IndexArray]]:
    """Yield ways to sort the rows (m,) into bins, each with the variable it stands for; of the joint itself first."""
    sign = np.sign(rows.dq[:, j])
    position, velocity, coarse = rows.bins_by_joint[j]
    yield "position", position
    yield "velocity", velocity
    yield "acceleration", _number_bins(rows.ddq[:, j], _BINS)
    yield "acceleration", _number_bins(rows.ddq[:, j] * sign, _BINS)
    yield "load", _number_bins(rows.load[:, j], _BINS)
    yield "time", _number_bins(rows.t, _BINS)
    for k, (other_position, other_velocity, other_coarse) in enumerate(rows.bins_by_joint):
        if k != j:
            yield "other_joints", other_position
            yield "other_joints", other_velocity
            yield "other_joints", coarse * _COARSE_BINS + other_coarse


def _number_bins(values: FloatArray, count: int) -> IndexArray:
    """Return the number of the bin (m,) of every row; all the same where a signal does not move."""
    low, high = np.quantile(values, [0.005, 0.995])
    if not high - low > 1e-9 * max(1.0, abs(low), abs(high)):
        return np.zeros(len(values), dtype=np.intp)
    numbers: IndexArray = np.clip(((values - low) / (high - low) * count).astype(np.intp), 0, count - 1)
    return numbers


def _compute_held_out_share(joint: _JointRows, bins: IndexArray) -> float:
    """Return the held-out share of the residual's variance that bin means explain; 0 where blocks disagree."""
    bins = bins[joint.telling]
    n_bins, n_blocks = int(bins.max(initial=0)) + 1, len(joint.fold)
    total = float((joint.targets[0] ** 2).sum())
    if n_bins < 2 or total <= 0.0:
        return 0.0
    cell = joint.row_block * n_bins + bins
    counts = np.bincount(cell, minlength=n_blocks * n_bins).reshape(n_blocks, n_bins)
    # Means of a bin come from four fifths of the blocks and are tried on the rest: a dependence has to predict.
    is_outside = joint.fold != np.arange(_FOLDS)[:, None]
    training_counts = is_outside @ counts
    best = 0.0
    for target in joint.targets:
        sums = np.bincount(cell, weights=target, minlength=n_blocks * n_bins).reshape(n_blocks, n_bins)
        means = np.where(training_counts >= _FEWEST, is_outside @ sums / np.maximum(training_counts, 1), 0.0)
        own = means[joint.fold]
        # Σ r² - (r - m)² over the rows of a bin.
        gains = (2 * sums * own - counts * own**2).sum(axis=1)
        share, t = float(gains.sum()) / total, compute_t(gains)
        if t >= _T or (share >= _LARGE and t >= _T_OF_LARGE):
            best = max(best, share)
    return best


def _find_cause(rows: _PatternRows, joint: _JointRows, j: int, comparison: Comparison, share: float) -> str:
    """Word what explains nearly as much as a pattern: the drive of another joint, or an offset that changes in time."""
    names, unit, telling = comparison.joint_names, comparison.units[j], joint.telling
    others = {k: _fit_other_drive(rows, j, k) for k in range(len(names)) if k != j and comparison.units[k] == unit}
    t = (rows.t[telling] - rows.t.min()) / max(float(np.ptp(rows.t)), np.finfo(float).tiny)
    # An offset that drifts does so slowly: a parabola over the whole recording.
    drift, coefficients = _fit_held_out(joint, np.column_stack([t, t**2]), _stack_own(rows, telling, j))
    k = max(others, key=lambda other: others[other][0], default=j)
    gain, (factor,) = others.get(k, (0.0, (0.0,)))
    is_enough = gain >= max(_OF_PATTERN * share, drift) and abs(factor) >= _LEAST_COUPLING
    # Where each of both drives explains the other joint, they share something that neither of them is.
    if is_enough and _fit_other_drive(rows, k, j)[0] < _SHARE:
        return (
            f"The torque of {names[j]} probably contains about {factor:.2g} times that of the drive of {names[k]}: "
            "their motors may be coupled, as in many wrists. If they are, state that among the robot's drives, "
            f'"{names[k]}": {{"coupling": {{"{names[j]}": {-factor:.2g}}}}}, and give the columns as currents with '
            "drive gains, of 1 if they are N m: stated as tau they count as torques of the joints."
        )
    if drift >= _OF_PATTERN * share:
        course = coefficients[0] * np.array([0.0, 0.5, 1.0]) + coefficients[1] * np.array([0.0, 0.25, 1.0])
        return (
            f"The offset of the torque of {names[j]} drifts by about {np.ptp(course):.2g} {unit} within a recording, "
            "as where a sensor warms up. Record after it has warmed up, or set it to zero before each recording and "
            "keep these short."
        )
    return ""


def _stack_own(rows: _PatternRows, telling: BoolArray, j: int) -> FloatArray:
    """Return what a joint's own friction, rotor, load and offset have taken of any cause already."""
    sign = np.sign(rows.dq[telling, j])
    signals = (signal[telling, j] for signal in (rows.dq, rows.ddq, rows.load))
    return np.column_stack([np.ones(len(sign)), sign, *signals])


def _fit_other_drive(rows: _PatternRows, j: int, k: int) -> tuple[float, FloatArray]:
    """Return the share of a joint's residual that the drive of another joint explains, and its factor (1,)."""
    joint = _JointRows.from_rows(rows, j)
    # Of the other joint's load the links of this one have taken their part: it is free with and without the drive.
    own = np.column_stack([_stack_own(rows, joint.telling, j), rows.load[joint.telling, k]])
    return _fit_held_out(joint, rows.drive[joint.telling, k : k + 1], own)


def _fit_held_out(joint: _JointRows, columns: FloatArray, own: FloatArray) -> tuple[float, FloatArray]:
    """Return the held-out share of the residual's variance that columns (m, c) explain, and their factors (c,).

    Each fold of blocks is predicted from the others. What the joint's own columns explain, which are free in every fit,
    does not count.
    """
    residual, fold = joint.targets[0], joint.fold[joint.row_block]
    total = float(residual @ residual)
    if total <= 0.0:
        return 0.0, np.zeros(columns.shape[1])

    def compute_left(rows: FloatArray) -> float:
        helds = [fold == number for number in range(_FOLDS)]
        errors = (residual[held] - rows[held] @ _solve(rows[~held], residual[~held]) for held in helds)
        return sum(float(error @ error) for error in errors)

    rows = np.column_stack([columns, own])
    gain = min(compute_left(own), total) - compute_left(rows)
    return gain / total, _solve(rows, residual)[: columns.shape[1]]


def _solve(rows: FloatArray, right: FloatArray) -> FloatArray:
    # Of equal size, so that small columns are not dropped.
    sizes = np.maximum(np.linalg.norm(rows, axis=0), np.finfo(float).tiny)
    solution: FloatArray = np.linalg.lstsq(rows / sizes, right, rcond=1e-9)[0] / sizes
    return solution


def _find_burst_patterns(comparisons: Sequence[Comparison], known: set[str]) -> list[UnknownPattern]:
    """Find joints whose residual is large in a few intervals of time, and depends on nothing else."""
    names = comparisons[0].joint_names
    inside, whole = np.zeros(len(names)), np.zeros(len(names))
    for c in comparisons:
        whole += (c.counted_residual**2).sum(axis=0)
        for segment, start, end in find_bursts(c):
            if end - start < _SHORTEST_BURST:
                continue
            hot = (c.segment == segment) & (c.t >= start) & (c.t <= end)
            inside += (c.counted_residual[hot] ** 2).sum(axis=0)
    share = inside / np.maximum(whole, np.finfo(float).tiny)
    if not share.any() or share.max() < _BURST_SHARE:
        return []
    worst = int(np.argmax(share))
    return [UnknownPattern(names[worst], "time", float(share[worst]))] if names[worst] not in known else []


# Of bursts: power over its median, averaging window (s), gap that ends one (s), number, and largest share of all rows.
_BURST_RATIO, _BURST_WINDOW, _BURST_GAP, _MOST_BURSTS, _LONGEST_BURSTS = 16.0, 0.1, 0.3, 3, 0.2


def find_bursts(comparison: Comparison) -> list[tuple[int, float, float]]:
    """Find intervals where the residual is far above the rest of the recording: (segment index, start, end in s)."""
    residual = np.where(comparison.counted_rows, comparison.residual, np.nan)
    silent = ~comparison.counted_rows.any(axis=0)
    usual = estimate_robust_scale(np.where(silent, 0.0, residual))
    # Where a joint stands, its torque says nothing of what else pulls at it.
    power = np.nan_to_num((residual / np.maximum(usual, 1e-300)) ** 2).sum(axis=1) / max(residual.shape[1], 1)
    if len(power) < 20:
        return []
    period = float(np.median(np.diff(comparison.t)))
    width = max(1, round(_BURST_WINDOW / period))
    smooth = np.convolve(power, np.ones(width) / width, mode="same")
    hot = np.flatnonzero(smooth > _BURST_RATIO * max(float(np.median(smooth)), 1.0))
    # What fills a fifth of the recording is no burst but a wrong model.
    if not len(hot) or len(hot) > _LONGEST_BURSTS * len(power):
        return []
    gap = (np.diff(comparison.t[hot]) > _BURST_GAP) | (np.diff(comparison.segment[hot]) != 0)
    parts = np.split(hot, np.flatnonzero(gap) + 1)
    # The strongest bursts first, since only a few are tried.
    parts.sort(key=lambda part: -float(power[part].sum()))
    return [
        (int(comparison.segment[part[0]]), float(comparison.t[part[0]]), float(comparison.t[part[-1]]))
        for part in parts[:_MOST_BURSTS]
        if len(part) > 2
    ]


# Number of blocks in all.
_BLOCKS = 30


def number_blocks(comparisons: Sequence[Comparison]) -> IndexArray:
    """Return the number (m,) of the block that every row of all comparisons is in."""
    length = sum(float(c.t[-1] - c.t[0]) for c in comparisons) / _BLOCKS
    offset, numbers = 0, []
    for c in comparisons:
        numbers.append(offset + np.floor((c.t - c.t[0]) / max(length, 1e-9)).astype(np.intp))
        offset = int(numbers[-1][-1]) + 1
    return np.concatenate(numbers)


def compute_median_error(errors: FloatArray) -> float:
    """Return the median of squared errors (s,) over the blocks that have any; 0 where none has.

    Blocks without rows leave none: where many passive joints rub, those in which none of them turns are few.
    """
    positive = errors[errors > 0.0]
    return float(np.median(positive)) if len(positive) else 0.0
