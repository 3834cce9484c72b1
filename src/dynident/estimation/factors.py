"""W and Y reduced to triangular factors: one per equation (joint) and stretch of time, all that later steps need.

The QR factor R of [W | Y] keeps every inner product of the columns without squaring their condition number, so
solving, weighting an equation, leaving a stretch out and choosing fewer columns are all small algebra on R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IndexArray
from dynident.estimation.beside import Apart, Beside, beside_all
from dynident.estimation.triangles import join, squared, triangular
from dynident.estimation.turned import Turned
from dynident.estimation.whitening import Whitened, whitened


@dataclass(frozen=True, eq=False)
class EquationFactors:
    """One equation's rows, stretch by stretch.

    `columns` (p,) are the parameters that the equation contains; `factors` (s, p + 1, p + 1) the triangular factor of
    [W | Y] of every stretch, Y last; `counts` (s,) the number of rows each stands for. `beside`: what was measured of
    the equation and is not fitted to, or is told apart; `turned`: rows where the joint turns round, which are in the
    factors with the weight that they have there.
    """

    columns: IndexArray
    factors: FloatArray
    counts: IndexArray
    beside: Beside | None = None
    turned: Turned | None = None

    def __repr__(self) -> str:
        rows = int(self.counts.sum())
        return f"EquationFactors({len(self.columns)} columns, {rows} rows in {len(self.counts)} stretches)"

    @cached_property
    def joined(self) -> FloatArray:
        """(p + 1, p + 1): the factor of all stretches together."""
        return join(self.factors)

    @cached_property
    def whitened(self) -> Whitened | None:
        """The columns without Y, whitened over all stretches; None where the equation sees none of them."""
        return whitened(self.factors[:, :, :-1], self.joined[:, :-1])

    @property
    def own_noise(self) -> float:
        """Noise that is left when the equation is fitted by itself: a first idea, before any parameter is known."""
        freedom = max(float(self.counts.sum()) - len(self.columns), 1.0)
        return abs(float(self.joined[-1, -1])) / float(np.sqrt(freedom))

    def without(self, stretches: Sequence[int]) -> FloatArray:
        """(p + 1, p + 1): the factor of all stretches but these."""
        keep = np.ones(len(self.factors), dtype=bool)
        keep[list(stretches)] = False
        return join(self.factors[keep])

    def select(self, columns: IndexArray) -> EquationFactors:
        """The same rows with only these parameters; parameters the equation does not contain are passed over.

        The positions in `columns` (k,) become the new parameter numbers.
        """
        where = {int(column): position for position, column in enumerate(self.columns)}
        chosen = [(new, where[int(old)]) for new, old in enumerate(columns) if int(old) in where]
        picked = [position for _, position in chosen] + [len(self.columns)]
        beside = None if self.beside is None else self.beside.select([position for _, position in chosen])
        numbers = np.array([new for new, _ in chosen], dtype=np.intp)
        if self.turned is not None:
            return self._of(numbers, self.turned.select(picked), beside)
        factors = triangular(self.factors[:, :, picked]) if len(self.factors) else self.factors
        return EquationFactors(numbers, squared(factors), self.counts, beside)

    def weighing_turns(self, weight: float) -> EquationFactors:
        """The same where the square of a row at which the joint turns round counts for so much beside another's."""
        if self.turned is None or self.turned.weight == weight:
            return self
        return self._of(self.columns, replace(self.turned, weight=weight), self.beside)

    @property
    def turning(self) -> Apart | Turned | None:
        """The rows where the joint turns round, each counting alike; None where they are not known."""
        kept = None if self.beside is None else self.beside.turning
        return self.turned if kept is None else kept

    @property
    def without_weights(self) -> EquationFactors:
        """The same where rows at which the joint turns round cannot be weighed any more, only told from the others."""
        if self.turned is None:
            return self
        beside = self.beside
        if beside is not None and beside.turning is None:
            beside = replace(beside, turning=self.turned.in_one)
        return EquationFactors(self.columns, self.factors, self.counts, beside)

    def _of(self, columns: IndexArray, turned: Turned, beside: Beside | None) -> EquationFactors:
        return EquationFactors(columns, turned.together, self.counts, beside, turned)

    def combined(self, weights: FloatArray) -> EquationFactors:
        """The same rows with columns that are combinations of these; `weights` (c, c') from all columns to the new."""
        own = weights[self.columns]
        chosen = np.flatnonzero((own != 0).any(axis=0))
        k = len(self.columns)
        whole = np.zeros((k + 1, len(chosen) + 1))
        whole[:k, :-1], whole[k, -1] = own[:, chosen], 1.0
        beside = None if self.beside is None else self.beside.combined(whole)
        if self.turned is not None:
            return self._of(chosen.astype(np.intp), self.turned.combined(whole), beside)
        factors = triangular(self.factors @ whole) if len(self.factors) else np.zeros((0, *whole.shape[1:] * 2))
        return EquationFactors(chosen.astype(np.intp), squared(factors), self.counts, beside)

    def changed(self, change: FloatArray, columns: IndexArray) -> EquationFactors:
        """The rows of [W | Y] change, change (p + 1, p' + 1): Y and W mixed; `columns` (p',) name the new columns.

        What is beside them is left out: a band about Y is none about what Y is made part of.
        """
        factors = triangular(self.factors @ change) if len(self.factors) else np.zeros((0, *change.shape[1:] * 2))
        return EquationFactors(np.asarray(columns, dtype=np.intp), squared(factors), self.counts)

    def squares(self, values: FloatArray) -> FloatArray:
        """(s,): sum of the squared residual of parameters χ (c,) in every stretch."""
        k = len(self.columns)
        rests = self.factors[:, :, k] - self.factors[:, :, :k] @ values[self.columns]
        return np.asarray((rests * rests).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Reduction:
    """All equations of a data set. `spans` (s, 2) are the first and last time of every stretch, in s."""

    n_columns: int
    equations: tuple[EquationFactors, ...]
    spans: FloatArray

    def __repr__(self) -> str:
        return (
            f"Reduction({len(self.equations)} equations of {self.n_columns} columns, {self.n_rows} rows in "
            f"{self.n_stretches} stretches)"
        )

    @property
    def n_stretches(self) -> int:
        """Number of stretches of time."""
        return len(self.spans)

    @property
    def n_rows(self) -> int:
        """Number of equations r, over all joints."""
        return int(sum(equation.counts.sum() for equation in self.equations))

    @property
    def row_counts(self) -> FloatArray:
        """(n,): number of rows of every equation."""
        return np.array([float(equation.counts.sum()) for equation in self.equations])

    def select(self, columns: Sequence[int] | IndexArray) -> Reduction:
        """The same data with only these columns, in this order."""
        chosen = np.asarray(columns, dtype=np.intp)
        return Reduction(len(chosen), tuple(e.select(chosen) for e in self.equations), self.spans)

    def combined(self, weights: FloatArray) -> Reduction:
        """The same data with columns that are combinations of these: W' = W weights, weights (c, c')."""
        return Reduction(weights.shape[1], tuple(e.combined(weights) for e in self.equations), self.spans)

    def weighing_turns(self, weights: FloatArray) -> Reduction:
        """The same data where rows at which joints turn round count for weights (n,), their squares beside others'."""
        pairs = zip(self.equations, weights, strict=True)
        return replace(self, equations=tuple(equation.weighing_turns(float(weight)) for equation, weight in pairs))

    @property
    def alike(self) -> Reduction:
        """The same data where every row counts alike."""
        return self.weighing_turns(np.ones(len(self.equations)))

    @property
    def without_weights(self) -> Reduction:
        """The same data where rows at which joints turn round cannot be weighed any more: it takes up less room."""
        return replace(self, equations=tuple(equation.without_weights for equation in self.equations))

    def stretches(self, indices: Sequence[int]) -> Reduction:
        """Only these stretches of time."""
        picked = list(indices)
        equations = tuple(EquationFactors(e.columns, e.factors[picked], e.counts[picked]) for e in self.equations)
        return Reduction(self.n_columns, equations, self.spans[picked])


def concatenate(parts: Sequence[Reduction]) -> Reduction:
    """Put data sets with the same columns behind one another."""
    first = parts[0]
    equations = tuple(_behind([part.equations[j] for part in parts]) for j in range(len(first.equations)))
    return Reduction(first.n_columns, equations, np.concatenate([part.spans for part in parts]))


def _behind(parts: Sequence[EquationFactors]) -> EquationFactors:
    """The same equation in several data sets; where joints turn round is told only where all of them know it."""
    told = [part.turned for part in parts if part.turned is not None]
    if len(told) < len(parts):
        parts = [part.without_weights for part in parts]
    return EquationFactors(
        parts[0].columns,
        np.concatenate([part.factors for part in parts]),
        np.concatenate([part.counts for part in parts]),
        beside_all([part.beside for part in parts]),
        Turned.joined(told) if len(told) == len(parts) else None,
    )


def told_apart(both: Reduction) -> Reduction:
    """One equation a joint from 2 n: n of the rows where no joint turns round, and behind them n of the others."""
    n = len(both.equations) // 2
    equations = []
    for steady, turning in zip(both.equations[:n], both.equations[n:], strict=True):
        turned = Turned.apart(steady.factors, turning.factors, turning.counts)
        counts = steady.counts + turning.counts
        equations.append(EquationFactors(steady.columns, turned.together, counts, steady.beside, turned))
    return replace(both, equations=tuple(equations))


class FactorAccumulator:
    """Folds rows into factors as they come.

    Parameters
    ----------
    columns : one (p,) array an equation
        The parameters that each equation contains.
    n_columns : int
        Number of all parameters c.
    stretch : float
        Length of a stretch of time, s.
    """

    # Rows collected before they are folded: QR of a tall block costs less than of many short ones.
    _PENDING = 2048

    def __init__(self, columns: Sequence[IndexArray], n_columns: int, stretch: float) -> None:
        self._columns = [np.asarray(item, dtype=np.intp) for item in columns]
        self._n_columns = n_columns
        self._stretch = stretch
        self._factors: list[list[FloatArray]] = [[] for _ in self._columns]
        self._counts: list[IndexArray] = []
        self._spans: list[tuple[float, float]] = []
        self._pending: list[list[FloatArray]] = [[] for _ in self._columns]
        self._pending_rows = 0
        self._open: list[FloatArray | None] = [None for _ in self._columns]
        self._count = np.zeros(len(self._columns), dtype=np.intp)
        self._is_open = False
        self._from = 0.0
        self._to = 0.0

    def push(self, t: FloatArray, rows: Sequence[FloatArray], used: BoolArray | None = None) -> None:
        """Add the next samples: times t (m,), and [W | Y] (m, p + 1) of every equation.

        `used` (m, equations): which rows of which equation count; all of them where it is left out.
        """
        first = 0
        while first < len(t):
            if not self._is_open:
                self._from, self._is_open = float(t[first]), True
            last = first + int(np.searchsorted(t[first:], self._from + self._stretch))
            if last > first:
                for k, (pending, block) in enumerate(zip(self._pending, rows, strict=True)):
                    part = block[first:last] if used is None else block[first:last][used[first:last, k]]
                    pending.append(part)
                    self._count[k] += len(part)
                self._pending_rows += last - first
                self._to = float(t[last - 1])
                if self._pending_rows >= self._PENDING:
                    self._fold()
            if last < len(t):
                self.end_stretch()
            first = last

    def end_stretch(self) -> None:
        """Close the stretch of time: a recording or a segment ends here."""
        if not self._is_open:
            return
        self._fold()
        for factors, factor in zip(self._factors, self._open, strict=True):
            assert factor is not None
            factors.append(squared(factor))
        self._counts.append(self._count.copy())
        self._spans.append((self._from, self._to))
        self._open = [None for _ in self._columns]
        self._count[:] = 0
        self._is_open = False

    def _fold(self) -> None:
        if self._pending_rows == 0:
            return
        for k, pending in enumerate(self._pending):
            before = self._open[k]
            stacked = np.concatenate(pending if before is None else [before, *pending])
            self._open[k] = triangular(stacked)
        self._pending = [[] for _ in self._columns]
        self._pending_rows = 0

    def finish(self) -> Reduction:
        """Close the last stretch and give all factors."""
        self.end_stretch()
        counts = np.array(self._counts, dtype=np.intp).reshape(-1, len(self._columns))
        equations = tuple(
            EquationFactors(
                columns,
                np.array(factors) if factors else np.zeros((0, len(columns) + 1, len(columns) + 1)),
                counts[:, k],
            )
            for k, (columns, factors) in enumerate(zip(self._columns, self._factors, strict=True))
        )
        return Reduction(self._n_columns, equations, np.array(self._spans).reshape(-1, 2))
