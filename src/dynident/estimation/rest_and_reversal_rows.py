"""Rows of an equation that are counted separately: at rest, next to a halt, and at reversals.

An equation of dry friction holds only while its joint moves, or reverses in one sweep. Where the joint stands still it
becomes two inequalities: the torque lies between what the model predicts for either direction of friction. Rows that
hold both a halt and motion next to it are equations of that motion.

At a reversal dry friction changes its sign. A model in which it jumps is wrong by many times the noise: the instant is
known only within some milliseconds, and real friction does not jump. A few of these rows may outweigh all others where
the motion is small, so they have a noise of their own, and a weight from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.estimation.qr import compute_r_factor, pad_to_square


@dataclass(frozen=True, eq=False)
class ReversalRows:
    """Factors of [W | Y] of the two kinds of rows of one equation with p columns, in s blocks of time.

    Parameters
    ----------
    others : (s, p + 1, p + 1)
        Of all rows but those at reversals.
    rows : (s, k, p + 1)
        Of the rows at reversals.
    counts : (s,)
        Number of rows at reversals.
    weight : float
        Weight of a squared residual at a reversal relative to one of the other rows.
    """

    others: FloatArray
    rows: FloatArray
    counts: IndexArray
    weight: float = 1.0

    @property
    def weighted_factors(self) -> FloatArray:
        """Factor (s, p + 1, p + 1) of all rows of every block, as they are weighted."""
        if not len(self.others):
            return self.others
        # The weight is that of squares; rows take its root.
        return pad_to_square(compute_r_factor(np.concatenate([self.others, np.sqrt(self.weight) * self.rows], axis=1)))

    @property
    def measured_squares(self) -> float:
        """Sum of squared Y at reversals."""
        return float((self.rows[:, :, -1] ** 2).sum())

    @property
    def count(self) -> int:
        """Number of rows at reversals."""
        return int(self.counts.sum())

    @property
    def row_group(self) -> RowGroup:
        """The rows at reversals, no longer by blocks."""
        return RowGroup(pad_to_square(compute_r_factor(self.rows.reshape(-1, self.rows.shape[2]))), self.count)

    def sum_squares(self, values: FloatArray) -> float:
        """Return the sum of squared residuals of parameters (p,) at reversals."""
        rest = self.rows[:, :, -1] - self.rows[:, :, :-1] @ values
        return float((rest * rest).sum())

    def select(self, picked: Sequence[int]) -> ReversalRows:
        """Return the same rows with only these of the p + 1 columns."""
        return self._replace_rows(self.others[:, :, picked], self.rows[:, :, picked])

    def combine_columns(self, change: FloatArray) -> ReversalRows:
        """Return the same rows with combined columns: [W | Y] change (p + 1, p' + 1)."""
        return self._replace_rows(self.others @ change, self.rows @ change)

    @classmethod
    def from_factors(cls, others: FloatArray, turning: FloatArray, counts: IndexArray) -> ReversalRows:
        """Build from factors (s, p + 1, p + 1) of either kind.

        Rows of the second kind that are zero in all blocks are dropped.

        Parameters
        ----------
        others : (s, p + 1, p + 1)
            Factors of the rows where no joint reverses.
        turning : (s, p + 1, p + 1)
            Factors of the rows at reversals.
        counts : (s,)
            Number of rows at reversals.

        Returns
        -------
        ReversalRows
            With a weight of 1.
        """
        # A block has few rows at reversals, so that most rows of its padded square factor are zero.
        filled = turning.any(axis=2).any(axis=0)
        return cls(others, turning[:, filled], counts)

    @classmethod
    def from_parts(cls, parts: Sequence[ReversalRows]) -> ReversalRows:
        """Concatenate the blocks of several recordings, every row with a weight of 1."""
        most = max(part.rows.shape[1] for part in parts)
        # Recordings differ in their number of rows at reversals; zero rows change no inner product.
        rows = [np.pad(part.rows, [(0, 0), (0, most - part.rows.shape[1]), (0, 0)]) for part in parts]
        others, counts = (np.concatenate(items) for items in zip(*((p.others, p.counts) for p in parts), strict=True))
        return cls(others, np.concatenate(rows), counts)

    def _replace_rows(self, others: FloatArray, rows: FloatArray) -> ReversalRows:
        return replace(
            self,
            others=pad_to_square(compute_r_factor(others)) if len(others) else _make_empty_factors(rows),
            rows=rows,
        )


def _make_empty_factors(rows: FloatArray) -> FloatArray:
    return np.zeros((0, rows.shape[-1], rows.shape[-1]))


MOST_REST_ROWS = 1000
"""Largest number of rows at rest that are kept of one equation of a recording. Of more, every so many-th row is kept.
"""


@dataclass(frozen=True, eq=False)
class RowGroup:
    """Rows that take part in the fit and whose residual is also known separately.

    Parameters
    ----------
    factor : (p + 1, p + 1)
        Triangular factor of [W | Y] of these rows.
    count : int
        Number of rows.
    """

    factor: FloatArray
    count: int

    def sum_squares(self, values: FloatArray) -> float:
        """Return the sum of squared residuals for parameters (p,)."""
        rest = self.factor[:, -1] - self.factor[:, :-1] @ values
        return float(rest @ rest)

    @property
    def measured_squares(self) -> float:
        """Sum of squared Y."""
        return float(self.factor[:, -1] @ self.factor[:, -1])

    def select(self, picked: Sequence[int]) -> RowGroup:
        """Return the same rows with only the columns `picked`."""
        return RowGroup(pad_to_square(compute_r_factor(self.factor[:, [*picked, -1]])), self.count)

    def combine_columns(self, change: FloatArray) -> RowGroup:
        """Return the same rows with combined columns: [W | Y] change, with change (p + 1, p' + 1)."""
        return RowGroup(pad_to_square(compute_r_factor(self.factor @ change)), self.count)

    @classmethod
    def from_parts(cls, parts: Sequence[RowGroup]) -> RowGroup:
        """Join the rows of several recordings."""
        factor = pad_to_square(compute_r_factor(np.concatenate([part.factor for part in parts])))
        return cls(factor, sum(part.count for part in parts))


@dataclass(frozen=True, eq=False)
class RestRows:
    """What one equation with p columns has besides the rows that only count while its joint moves.

    Parameters
    ----------
    turning : RowGroup or None
        Rows at reversals of the joint, which take part in the fit; None where the equation keeps them by blocks of time
        (`ReversalRows`).
    partial : RowGroup
        Rows next to a halt, of the motion in them alone. They take part in the fit.
    upper, lower : (m, p)
        Rows of W at rest, with the friction of either direction.
    y : (m,)
        What was measured there.
    weights : (m,)
        Number of rows that each of these rows stands for.
    """

    turning: RowGroup | None
    partial: RowGroup
    upper: FloatArray
    lower: FloatArray
    y: FloatArray
    weights: FloatArray

    def sum_standing_squares(self, values: FloatArray) -> float:
        """Return the weighted sum of squared distances of y at rest to the friction band of parameters (p,)."""
        return float(self.weights @ compute_band_distance(self.y, self.lower @ values, self.upper @ values) ** 2)

    @property
    def standing_measured_squares(self) -> float:
        """Sum of squared Y at rest."""
        return float(self.weights @ self.y**2)

    @property
    def n_standing(self) -> float:
        """Number of rows at rest."""
        return float(self.weights.sum())

    def select(self, places: Sequence[int]) -> RestRows:
        """Return the same rows with only the columns at `places`."""
        picked = list(places)
        turning = None if self.turning is None else self.turning.select(picked)
        upper, lower = self.upper[:, picked], self.lower[:, picked]
        return replace(self, turning=turning, partial=self.partial.select(picked), upper=upper, lower=lower)

    def combine_columns(self, change: FloatArray) -> RestRows:
        """Return the same rows with combined columns: [W | Y] change (p + 1, p' + 1), where Y must stay as it is."""
        # Rows at rest keep W and y apart, because the band needs both: only the columns of W are combined.
        column_change = change[:-1, :-1]
        turning = None if self.turning is None else self.turning.combine_columns(change)
        upper, lower = self.upper @ column_change, self.lower @ column_change
        return replace(self, turning=turning, partial=self.partial.combine_columns(change), upper=upper, lower=lower)


def compute_band_distance(y: FloatArray, first_bound: FloatArray, second_bound: FloatArray) -> FloatArray:
    """Return the signed distance of y to the band between two bounds.

    Parameters
    ----------
    y, first_bound, second_bound : arrays
        Torque and the two bounds, N m or N: of any shape, the same for all three. The bounds may be in either order.

    Returns
    -------
    array
        Distance of that shape, N m or N: zero inside the band, positive above it.
    """
    return np.asarray(y - np.clip(y, np.minimum(first_bound, second_bound), np.maximum(first_bound, second_bound)))


def join_rest_rows(parts: Sequence[RestRows | None]) -> RestRows | None:
    """Join the rows at rest and at reversals of several recordings; None where one recording does not have them."""
    # If one recording did not collect its rows at rest, the errors at rest of all of them together are not known.
    known = [part for part in parts if part is not None]
    if len(known) < len(parts) or not known:
        return None
    turning = [part.turning for part in known if part.turning is not None]
    return RestRows(
        turning=RowGroup.from_parts(turning) if len(turning) == len(known) else None,
        partial=RowGroup.from_parts([part.partial for part in known]),
        upper=np.concatenate([part.upper for part in known]),
        lower=np.concatenate([part.lower for part in known]),
        y=np.concatenate([part.y for part in known]),
        weights=np.concatenate([part.weights for part in known]),
    )


class RestRowAccumulator:
    """Collects the rows at rest and next to halts of one equation, block by block.

    Parameters
    ----------
    n_columns : int
        Number of columns p of the equation.
    """

    def __init__(self, n_columns: int) -> None:
        self._p = n_columns
        self._partial = RowGroup(np.zeros((n_columns + 1, n_columns + 1)), 0)
        self._parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []

    def push_partial(self, rows: FloatArray) -> None:
        """Add rows of [W | Y] (m, p + 1) of the motion next to a halt."""
        self._partial = _append_rows(self._partial, rows)

    def push_standing(self, upper: FloatArray, lower: FloatArray, y: FloatArray) -> None:
        """Add rows at rest.

        Parameters
        ----------
        upper, lower : (m, p)
            Rows of W with the friction of either direction.
        y : (m,)
            What was measured there.
        """
        if len(y):
            self._parts.append((upper, lower, y))

    def finish(self) -> RestRows:
        """Return all rows that were collected, thinned to at most `MOST_REST_ROWS` at rest."""
        parts = self._parts or [(np.zeros((0, self._p)), np.zeros((0, self._p)), np.zeros(0))]
        upper, lower, y = (np.concatenate(items) for items in zip(*parts, strict=True))
        # Ceiling division. The rows that stay count for the ones left out, so that sums over them keep their size.
        stride = -(-len(y) // MOST_REST_ROWS) if len(y) else 1
        weights = np.full(len(y[::stride]), len(y) / max(len(y[::stride]), 1))
        thinned = upper[::stride], lower[::stride], y[::stride]
        return RestRows(None, self._partial, *thinned, weights)


def _append_rows(known: RowGroup, rows: FloatArray) -> RowGroup:
    if not len(rows):
        return known
    return RowGroup(pad_to_square(compute_r_factor(np.concatenate([known.factor, rows]))), known.count + len(rows))
