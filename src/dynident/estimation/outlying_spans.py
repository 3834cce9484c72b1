"""Find spans of time whose residual is far above that of all other rows, by leaving each out in turn.

Holds the ratio that counts as disturbed (25), and how much may be left out.

Least squares spreads a disturbance of a few seconds over all parameters and rows, so that its residual stands out
nowhere. So every span is left out in turn and the parameters are solved from the other rows. The drop of the residual
per row of the span, over the residual per remaining row, is Chow's test: about 1 where the span is like the
rest, also where its motion is unlike that of the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.estimation.triangular_factors import EquationFactors, Reduction

OUTLYING_RATIO = 25.0
"""Ratio above which a span counts as disturbed: five times the residual of the rest.

Clean arms reach 1.4; of 100 arms with friction, springs or loads that the model lacks two reached 9 and 14, the others
5 (`benchmarks/outlying_spans.py`); a real arm that starts from rest 12, an elastic one 17. A push of a tenth of what
the second joint can hold reaches 50, of a fifth 4,000.
"""

_MOST_SPANS = 3
_MOST_SHARE = 0.5
"""Largest share of all rows in spans: what lasts longer is the rule, and the rest is the exception."""

_MOST_OF_RUN = 0.8
"""Share of one of several segments above which the whole segment differs: it carried a load, or was warm."""

_BLOCKS = 32
"""Largest number of blocks of time that spans are made of in one segment: hundreds of spans then, not thousands."""

_ROUNDS = 3
"""Rounds that estimate every equation's noise from the rows outside the span; the second changes it by a few per cent.
"""

_DRIFTS = 0.5
"""Share of the squared residual that a drift leaves at most: less is a coincidence."""

_WARMING = (np.inf, 0.5, 0.25, 0.125)
"""Time constants of a warm-up, as shares of a recording; infinite: a steady change."""

_QUIET = 1e-3
"""Share of the torque that no sensor resolves: in noiseless data a smaller residual counts as none."""

# Added to the diagonal of normal equations in columns of unit length, see `_solve_products`.
_RIDGE = 1e-9
# Numbers in the products of the windows that are solved at once: enough for fast array operations, few enough for
# the cache.
_BATCH = 2**19
# Share of the ratio that the bounds of all windows have to stay below, so that rounding and the ridge do not decide.
_CLEARLY = 0.9


@dataclass(frozen=True)
class OutlyingSpan:
    """One span of time whose residual stands out.

    Parameters
    ----------
    first, last : int
        Blocks of time `first` to `last` (exclusive).
    start, end : float
        First and last time, s.
    ratio : float
        Squared residual per row of the span over that of the other rows, solved without it.
    """

    first: int
    last: int
    start: float
    end: float
    ratio: float


@dataclass(frozen=True, eq=False)
class OutlyingSpans:
    """Spans that stand out, and the parameters that were solved without them.

    Parameters
    ----------
    spans : tuple of OutlyingSpan
        The largest ratio first.
    values : (c,)
        Parameters χ from all rows outside these spans.
    drifts : bool
        Whether parameters that change slowly explain what stands out better than any span: friction that warms up.
    """

    spans: tuple[OutlyingSpan, ...]
    values: FloatArray
    drifts: bool = False


def find_outlying_spans(reduction: Reduction, ratio: float = OUTLYING_RATIO) -> OutlyingSpans:
    """Find spans of time whose residual stands out.

    Parameters
    ----------
    reduction : Reduction
        Equations by blocks of time.
    ratio : float
        Squared residual of a row of the span over that of the others, above which it stands out.

    Returns
    -------
    OutlyingSpans
        At most three spans, each inside one segment and all together at most half of the rows; whole segments are left
        out.
    """
    if not reduction.n_blocks:
        return OutlyingSpans((), np.zeros(reduction.n_columns))
    search = _SpanSearch(reduction)
    outlying: list[OutlyingSpan] = []
    # Greedy: a large disturbance hides smaller ones, so each span is left out before the next one is sought. A whole
    # segment is left out as well, without being reported.
    for _ in range(_MOST_SPANS):
        best = search.find_best_window(ratio)
        if best is None:
            break
        if search.is_drift(*best[:2]):
            return OutlyingSpans((), _SpanSearch(reduction).solve_parameters(), drifts=True)
        search.leave_out(*best[:2])
        span = search.describe_span(*best)
        outlying += [] if span is None else [span]
    return OutlyingSpans(tuple(sorted(outlying, key=lambda span: -span.ratio)), search.solve_parameters())


class _SpanSearch:
    """Inner products of every equation and block, which a search for outlying spans leaves out.

    Each of the n equations has products of the columns that it has, (s, p + 1, p + 1): of a machine with many joints
    most equations have few. Rows are (n, s), the blocks' segments (s,). `firsts` (s + 1,): the first fine block of
    every coarse one, and their number.
    """

    def __init__(self, reduction: Reduction) -> None:
        self._n_columns, self._spans = reduction.n_columns, reduction.spans
        run = _number_segments(reduction.spans)
        self._firsts = _find_block_edges(run)
        starts = self._firsts[:-1]
        self._run = run[starts]
        self._own = [np.append(equation.columns, reduction.n_columns) for equation in reduction.equations]
        counts = np.array([equation.counts for equation in reduction.equations], dtype=np.float64)
        self._counts = np.add.reduceat(counts, starts, axis=1)
        # Prefix sums: the products of any window are one difference, which makes hundreds of windows cheap.
        self._sums = [_sum_prefixes(equation, starts) for equation in reduction.equations]
        self._total, self._rows = [sums[-1] for sums in self._sums], self._counts.sum(axis=1)
        self._out = np.zeros(len(starts), dtype=bool)
        # The first guess of an equation's noise is all that it measured; rounds of the search replace it.
        squares = np.array([total[-1, -1] for total in self._total]) / np.maximum(self._rows, 1.0)
        # Wχ = 0, as of a base that nothing touches, measures nothing that its residual could be compared with.
        moves = np.array([total[:-1, :-1].any() for total in self._total])
        squares = np.where((squares == 0) & moves, np.inf, squares)
        self._floor = _QUIET**2 * squares + np.finfo(float).tiny
        self._noise = np.maximum(squares, self._floor)

    def _add_equations(self, products: Sequence[FloatArray]) -> FloatArray:
        """Return the sum (..., c + 1, c + 1) of the equations' products, each in units of its noise."""
        c = self._n_columns + 1
        sums = np.zeros((*products[0].shape[:-2], c, c))
        for own, each, noise in zip(self._own, products, self._noise, strict=True):
            sums[..., own[:, None], own] += each / noise
        return sums

    def solve_parameters(self) -> FloatArray:
        """Return the parameters (c,) from all rows that are not left out."""
        return _solve_products(self._add_equations(self._total))

    def leave_out(self, first: int, last: int) -> None:
        """Remove blocks from the data."""
        self._total = self._subtract_window(first, last)
        self._rows = self._rows - self._counts[:, first:last].sum(axis=1)
        self._out[first:last] = True

    def _subtract_window(self, first: int, last: int) -> list[FloatArray]:
        """Return the products of every equation without those of some blocks."""
        return [total - (sums[last] - sums[first]) for total, sums in zip(self._total, self._sums, strict=True)]

    def is_drift(self, first: int, last: int) -> bool:
        """Tell whether parameters that change slowly explain more than as many of a span's own.

        An interruption has two ends, and the same parameters before and behind. Friction that warms up changes fast at
        first, then ever more slowly, so that any border between a span and the rest is as good as another.
        """
        sums = self._add_equations(self._sums)
        inside, blocks = sums[last] - sums[first], np.diff(sums, axis=0)
        blocks[self._out] = 0.0
        total = blocks.sum(axis=0)
        whole, own, rest = (
            float(_compute_squares(part, _solve_products(part))) for part in (total, inside, total - inside)
        )
        changing = np.array([_add_changing_columns(blocks, change) for change in self._list_changes()])
        left = float(_compute_squares(changing, _solve_products(changing)).min())
        return left < min(own + rest, _DRIFTS * whole)

    def _list_changes(self) -> list[FloatArray]:
        """Return courses (s,) of a slow change over all blocks, and over those of each segment anew."""
        over_all = (np.arange(len(self._run)) + 0.5) / len(self._run)
        numbers, lengths = np.arange(len(self._run)), np.bincount(self._run)
        over_each = (numbers - np.searchsorted(self._run, self._run) + 0.5) / lengths[self._run]
        clocks = [over_all, over_each] if len(lengths) > 1 else [over_all]
        return [np.exp(-clock / part) if np.isfinite(part) else clock for clock in clocks for part in _WARMING]

    def describe_span(self, first: int, last: int, ratio: float) -> OutlyingSpan | None:
        """Describe blocks as a span; None where they are nearly a whole segment of several."""
        own = self._counts[:, self._run == self._run[first]].sum()
        # A disturbance of nearly a whole segment is no disturbance: that segment differs from the others.
        if self._run[-1] > 0 and self._counts[:, first:last].sum() > _MOST_OF_RUN * own:
            return None
        intervals = int(self._firsts[first]), int(self._firsts[last])
        return OutlyingSpan(
            *intervals, float(self._spans[intervals[0], 0]), float(self._spans[intervals[1] - 1, 1]), ratio
        )

    def _list_windows(self) -> list[tuple[int, int]]:
        """Return consecutive blocks inside one segment, of at most half of the rows, that are not left out yet."""
        rows, out = np.append(0.0, np.cumsum(self._counts.sum(axis=0))), np.append(0, np.cumsum(self._out))
        most = _MOST_SHARE * rows[-1] - self._counts[:, self._out].sum()
        return [
            (a, b)
            for a in range(len(self._run))
            for b in range(a + 1, len(self._run) + 1)
            if self._run[a] == self._run[b - 1] and 0 < rows[b] - rows[a] <= most and out[a] == out[b]
        ]

    def find_best_window(self, ratio: float) -> tuple[int, int, float] | None:
        """Find the blocks without which the others leave least, and their ratio, where they stand out."""
        windows = self._list_windows()
        if not windows or self._rows.sum() <= self._n_columns + 1:
            return None
        best = None
        rows = self._rows.sum()
        ends = np.array(windows)
        counted = np.append(0.0, np.cumsum(self._counts.sum(axis=0)))
        inside = counted[ends[:, 1]] - counted[ends[:, 0]]
        freedom = np.maximum(rows - inside - self._n_columns, 1.0)
        batch = max(1, _BATCH // (self._n_columns + 1) ** 2)
        finite = np.isfinite(self._floor)
        for number in range(_ROUNDS):
            weights = 1.0 / self._noise
            total, sums = self._add_equations(self._total), self._add_equations(self._sums)
            # Squared residual of all rows, then of the rows outside each window, both with the same weights.
            whole = max(float(_compute_squares(total, _solve_products(total))), 0.0)
            # Noiseless data would divide by rounding errors.
            least = float((weights[finite] * self._floor[finite]).mean()) * freedom
            if number == 0:
                # One solution for both sides of a window leaves at least what a solution for each side leaves. These
                # are some dozens instead of hundreds, and mostly tell that no window stands out.
                before, behind = self._compute_rest_bounds(sums)
                bound = np.maximum(before[ends[:, 0]] + behind[ends[:, 1]], least)
                if np.all(np.maximum(whole - bound, 0.0) / inside < _CLEARLY * ratio * bound / freedom):
                    return None
            rest = np.concatenate(
                [self._compute_rest_squares(total, sums, windows[k : k + batch]) for k in range(0, len(windows), batch)]
            )
            rest = np.maximum(rest, least)
            ratios = np.maximum(whole - rest, 0.0) / inside / (rest / freedom)
            # Of spans that stand out, the one that leaves the others the most likely ends where the disturbance does.
            gain = np.where(
                ratios >= ratio, (rows - inside) * np.log(whole / rows / (rest / freedom) + 1e-300), -np.inf
            )
            k = int(np.argmax(gain))
            if not np.isfinite(gain[k]):
                return None
            a, b = windows[k]
            best = (a, b, float(ratios[k]))
            # The noise for the next round comes from the rows outside the best window: its own rows would raise it.
            outside = self._subtract_window(a, b)
            values = _solve_products(self._add_equations(outside))
            own_values = (values[own[:-1]] for own in self._own)
            squares = [float(_compute_squares(*each)) for each in zip(outside, own_values, strict=True)]
            rows_left = np.maximum(self._rows - self._counts[:, a:b].sum(axis=1), 1.0)
            self._noise = np.maximum(np.array(squares) / rows_left, self._floor)
        return best

    def _compute_rest_bounds(self, sums: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the least squared residuals (s + 1,) of the blocks before each border, and of those behind it."""
        blocks = np.diff(sums, axis=0)
        blocks[self._out] = 0.0
        before = np.concatenate([np.zeros_like(sums[:1]), np.cumsum(blocks, axis=0)])
        either = np.stack([before, before[-1] - before])
        squares = _compute_squares(either, _solve_products(either))
        return squares[0], squares[1]

    def _compute_rest_squares(
        self, total: FloatArray, sums: FloatArray, windows: Sequence[tuple[int, int]]
    ) -> FloatArray:
        """Return the squared residual (w,) of the rows outside each window, solved from them."""
        outside = np.array([total - (sums[b] - sums[a]) for a, b in windows])
        return _compute_squares(outside, _solve_products(outside))


def _sum_prefixes(equation: EquationFactors, starts: IndexArray) -> FloatArray:
    """Return the products (s + 1, p + 1, p + 1) of an equation's columns over the blocks before each."""
    # Inner products instead of factors: they can be subtracted, which leaves a window out at no cost.
    squared = equation.factors.transpose(0, 2, 1) @ equation.factors
    blocks = np.add.reduceat(squared, starts, axis=0)
    return np.concatenate([np.zeros((1, *blocks.shape[1:])), np.cumsum(blocks, axis=0)])


def _add_changing_columns(blocks: FloatArray, change: FloatArray) -> FloatArray:
    """Return the products (2 c + 1, 2 c + 1) of blocks (s, c + 1, c + 1) with every column also times a change (s,)."""
    plain, once, twice = (np.tensordot(power, blocks, axes=1) for power in (change**0, change, change**2))
    return np.block([[twice[:-1, :-1], once[:-1]], [once[:, :-1], plain]])


def _find_block_edges(run: IndexArray) -> IndexArray:
    """Return the first interval of every block, and their number; every segment begins a block."""
    s = len(run)
    borders = np.flatnonzero(np.diff(run)) + 1
    edges: IndexArray = np.unique(np.concatenate([np.arange(0, s, -(-s // _BLOCKS)), borders, [s]]))
    return edges


def _number_segments(spans: FloatArray) -> IndexArray:
    """Return the segment number (s,) of every interval.

    Time jumps by more than an interval, or back, between two segments.
    """
    if not len(spans):
        return np.zeros(0, dtype=np.intp)
    pause = spans[1:, 0] - spans[:-1, 1]
    jumps = (pause > float(np.median(spans[:, 1] - spans[:, 0]))) | (pause < 0)
    return np.concatenate([[0], np.cumsum(jumps)]).astype(np.intp)


def _solve_products(products: FloatArray) -> FloatArray:
    """Return the least-squares solution (…, c) of products (…, c + 1, c + 1), the smallest where it is not unique."""
    c = products.shape[-1] - 1
    diagonal = np.einsum("...ii->...i", products[..., :c, :c])
    scale = np.where(diagonal > 0, np.sqrt(np.maximum(diagonal, 0.0)), 1.0)
    # Normal equations are good enough here: ratios are compared, not parameters reported. The ridge keeps them solvable
    # where a window takes all that a parameter needs.
    normal = products[..., :c, :c] / scale[..., :, None] / scale[..., None, :] + _RIDGE * np.eye(c)
    return np.asarray(np.linalg.solve(normal, (products[..., :c, c] / scale)[..., None])[..., 0] / scale)


def _compute_squares(products: FloatArray, values: FloatArray) -> FloatArray:
    """Return the squared residual (…,) of parameters (…, c)."""
    signed = np.concatenate([-values, np.ones((*values.shape[:-1], 1))], axis=-1)
    return np.asarray(np.maximum(np.einsum("...i,...ij,...j->...", signed, products, signed), 0.0))
