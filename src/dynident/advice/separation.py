"""How far two effects can be told apart by data at hand, and by a motion that is only proposed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.advice.result import Separation
from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.comparing.compare import Comparison
from dynident.estimation.correlation import overstatement
from dynident.estimation.least_squares import floored
from dynident.excitation import Rehearsal
from dynident.excitation.criteria.variances import inverse_diagonal_of
from dynident.excitation.experiments.task import STANDS
from dynident.excitation.observation.model import DesignModel
from dynident.motion.trajectories.motion import Motion
from dynident.recordings import Recording
from dynident.recordings.phases import Phase
from dynident.regressors.stream import in_run

_MOST_ROWS = 1500
"""Samples that a matrix of inner products is made from: beyond them only its precision grows, not what it says."""

_MOST_DATA_ROWS = 5000
"""Samples of the data at hand: how residuals hang together is seen in neighbours alone, so these are thinned later."""

# Stretches over which correlated residuals are summed: a twentieth of the data, within these seconds.
_STRETCHES, _SHORTEST, _LONGEST = 20, 0.25, 2.0
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """WᵀW (b, b) and Wᵀρ (b,) in units of the noise: what rows of data tell about the parameters."""

    matrix: FloatArray
    right: FloatArray

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.matrix + other.matrix, self.right + other.right)


@dataclass(frozen=True, eq=False)
class Rows:
    """Data at hand beside a model with more effects: w (m, n, b), residual (m, n) of the model without them.

    Both are zero where a joint stands; `counts` (n,) are the rows of every joint where it moves.

    `n_rows` rows of data are like these; `stretch` consecutive ones of them belong together; `borders` are where
    recordings begin and end.
    """

    w: FloatArray
    residual: FloatArray
    counts: FloatArray
    n_rows: int
    stretch: int
    borders: tuple[int, ...]

    @property
    def share(self) -> float:
        """Rows of data that one of these stands for."""
        return self.n_rows / max(len(self.w), 1)

    def information(self, row_weights: FloatArray) -> NormalEquations:
        """What they tell; row_weights (n,) are one over the noise of a row of data."""
        weights = row_weights * np.sqrt(self.share)
        weighted = (self.w * weights[:, None]).reshape(-1, self.w.shape[2])
        return NormalEquations(weighted.T @ weighted, weighted.T @ (self.residual * weights).reshape(-1))

    def earlier(self, n_rows: float) -> FloatArray:
        """Rows (b n, b), joint after joint, that stand for them beside W / √N of n_rows of an experiment."""
        factors = [np.linalg.qr(self.w[:, j], mode="r") for j in range(self.w.shape[1])]
        most = max(len(factor) for factor in factors)
        padded = [np.pad(factor, ((0, most - len(factor)), (0, 0))) for factor in factors]
        made: FloatArray = np.stack(padded, axis=1).reshape(-1, self.w.shape[2])
        return made * float(np.sqrt(self.share / n_rows))


def rows_of(model: DesignModel, comparisons: Sequence[Comparison], recordings: Sequence[Recording] = ()) -> Rows:
    """The data at hand, as far as they are needed, in the columns of a model.

    `recordings` are those of the comparisons: what is in some runs is in these alone. Without them it is in all.
    """
    total = sum(len(one.t) for one in comparisons)
    every = max(1, -(-total // _MOST_DATA_ROWS))
    w, residual, borders, seconds, step = [], [], [0], 0.0, 1.0
    n, b = model.robot.n, model.n_parameters
    counts = np.zeros(n)
    for number, one in enumerate(comparisons):
        if len(one.t) < 2:
            continue
        step = float(np.median(np.diff(one.t)))
        seconds += step * len(one.t)
        jerk = np.gradient(one.ddq, step, axis=0)
        motion = Motion(step * np.arange(len(one.t), dtype=np.float64), one.q, one.dq, one.ddq, jerk)
        taken = np.arange(0, len(one.t), every)
        runs = _runs_of(model, one.segment[taken], recordings[number]) if recordings else None
        # As in a fit: the equation of a joint that stands tells nothing but that friction is enough to hold it.
        moves = one.phase[taken] != Phase.STANDING
        w.append(model.observe_along(motion, taken, runs).reshape(len(taken), n, b) * moves[:, :, None])
        residual.append(one.residual[taken] * moves)
        counts += moves.sum(axis=0)
        borders.append(borders[-1] + len(taken))
    stretch = max(1, round(float(np.clip(seconds / _STRETCHES, _SHORTEST, _LONGEST)) / (step * every)))
    return Rows(np.concatenate(w), np.concatenate(residual), counts, total, stretch, tuple(borders))


def _runs_of(model: DesignModel, segments: FloatArray, recording: Recording) -> FloatArray:
    """(m, number of run signals): 1 where a row of one of these segments (m,) is in the signal's runs."""
    signals = model.observation.runs
    known = {int(one): [in_run(signal, recording, int(one)) for signal in signals] for one in np.unique(segments)}
    return np.array([known[int(one)] for one in segments]).reshape(len(segments), len(signals))


def row_weights(rows: Rows) -> FloatArray:
    """(n,): one over the noise that every row would have if rows were independent of each other.

    The noise is what is left once all effects of the model are fitted, those in doubt included: an effect that is
    missing must not count as noise of the experiment that is to show it.
    """
    n, b = rows.w.shape[1:]
    freedom = np.maximum(rows.counts - b / n, 1.0)
    noise = floored(np.sqrt((rows.residual**2).sum(axis=0) / freedom))
    rest = rows.residual
    for _ in range(_ROUNDS):
        known = rows.information(1.0 / noise)
        rest = rows.residual - rows.w @ _solved(known.matrix, known.right)
        noise = floored(np.sqrt((rest**2).sum(axis=0) / freedom))
    overstated = np.array([_overstated(rows, rest, j) for j in range(n)])
    return np.asarray(1.0 / (noise * np.sqrt(overstated * rows.share)))


def _overstated(rows: Rows, rest: FloatArray, joint: int) -> float:
    """By how much these rows of a joint overstate the information in them, at least 1."""
    starts = [
        at
        for first, last in zip(rows.borders, rows.borders[1:], strict=False)
        for at in range(first, last - rows.stretch + 1, rows.stretch)
    ]
    if not starts:
        return 1.0
    taken = np.array(starts)[:, None] + np.arange(rows.stretch)
    w = rows.w[:, joint]
    used = np.flatnonzero((w != 0).any(axis=0))
    return overstatement(w[taken][:, :, used], rest[taken, joint], float(np.count_nonzero(rest[taken, joint])))


def of_rehearsal(model: DesignModel, rehearsal: Rehearsal, row_weights: FloatArray) -> NormalEquations:
    """The information that an experiment would give, whose rows have the noise 1 / row_weights (n,)."""
    motion = rehearsal.motion
    taken = _spread(len(motion.t))
    w = model.observe_along(motion, taken)
    moves = np.abs(motion.dq[taken]) > STANDS
    weights = (row_weights * moves).reshape(-1) * np.sqrt(rehearsal.n_samples / len(taken))
    weighted = w * weights[:, None]
    return NormalEquations(weighted.T @ weighted, np.zeros(w.shape[1]))


def _spread(count: int) -> IndexArray:
    """Evenly spread samples of a motion."""
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_ROWS)).astype(np.intp))


def amplitudes(found: NormalEquations, suspect: Sequence[int], rivals: Sequence[int]) -> FloatArray:
    """Parameters of the suspect alone, fitted to the residual beside the model and without its rivals."""
    kept = [k for k in range(len(found.right)) if k not in set(rivals) - set(suspect)]
    solved = _solved(found.matrix[np.ix_(kept, kept)], found.right[kept])
    return np.asarray(solved[[kept.index(k) for k in suspect]])


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """The shortest solution, in columns of equal size, of what may have no other than many."""
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    return np.asarray(np.linalg.lstsq(matrix / np.outer(scale, scale), right / scale, rcond=1e-9)[0] / scale)


def separation(model: DesignModel, known: NormalEquations, parameter: int, size: float | None) -> Separation:
    """How well a parameter comes out beside everything else in the model.

    `size` is its amplitude, None where nobody knows it.
    """
    found = inverse_diagonal_of(known.matrix)
    deviation = float(np.sqrt(found.variances[parameter]))
    column = model.kept[parameter]
    return Separation(
        parameter=column.name,
        unit=column.unit,
        share=float(found.shares[parameter]),
        standard_deviation=deviation,
        t_value=None if size is None else abs(size) / deviation,
    )
