"""Rows of an equation that are told apart: where friction changes its sign, and where it has none.

An equation of dry friction is an equation only while its joint moves, or turns round in one sweep. Where the joint
stands it is two inequalities: the torque lies between what the model says for either direction. Rows that hold a halt
and motion beside it are equations of that motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.estimation.triangles import squared, triangular

MOST = 1000
"""Rows at rest that are kept of one equation of a recording; of more, every so many-th."""


@dataclass(frozen=True, eq=False)
class Apart:
    """Rows that are fitted to with all others, and known apart: `factor` (p + 1, p + 1) of [W | Y], of `count` rows."""

    factor: FloatArray
    count: int

    def squares(self, values: FloatArray) -> float:
        """Squared residual of parameters (p,)."""
        rest = self.factor[:, -1] - self.factor[:, :-1] @ values
        return float(rest @ rest)

    @property
    def measured(self) -> float:
        """Sum of squared Y."""
        return float(self.factor[:, -1] @ self.factor[:, -1])

    def select(self, picked: Sequence[int]) -> Apart:
        """The same with only these of the columns."""
        return Apart(squared(triangular(self.factor[:, [*picked, -1]])), self.count)

    def combined(self, change: FloatArray) -> Apart:
        """The same with columns that are combinations: [W | Y] change (p + 1, p' + 1)."""
        return Apart(squared(triangular(self.factor @ change)), self.count)

    @classmethod
    def joined(cls, parts: Sequence[Apart]) -> Apart:
        """Those of several recordings."""
        factor = squared(triangular(np.concatenate([part.factor for part in parts])))
        return cls(factor, sum(part.count for part in parts))


@dataclass(frozen=True, eq=False)
class Beside:
    """What one equation, with p columns, has beside the rows that only count while its joint moves.

    `turning`: rows where the joint turns round, None where the equation tells them apart by stretches; `partial`: rows
    beside a halt, of the motion in them alone. Both are among those that are fitted to. `upper`, `lower` (m, p) are
    rows of W at rest with the friction of either direction, `y` (m,) what was measured there, and `weights` (m,) the
    rows that each stands for.
    """

    turning: Apart | None
    partial: Apart
    upper: FloatArray
    lower: FloatArray
    y: FloatArray
    weights: FloatArray

    def standing_squares(self, values: FloatArray) -> float:
        """Squared distance of what was measured at rest to the band of parameters (p,)."""
        return float(self.weights @ distance_to_band(self.y, self.lower @ values, self.upper @ values) ** 2)

    @property
    def standing_measured(self) -> float:
        """Sum of squared Y at rest."""
        return float(self.weights @ self.y**2)

    @property
    def n_standing(self) -> float:
        """Number of rows at rest."""
        return float(self.weights.sum())

    def select(self, places: Sequence[int]) -> Beside:
        """The same with only these of the columns."""
        picked = list(places)
        turning = None if self.turning is None else self.turning.select(picked)
        upper, lower = self.upper[:, picked], self.lower[:, picked]
        return replace(self, turning=turning, partial=self.partial.select(picked), upper=upper, lower=lower)

    def combined(self, change: FloatArray) -> Beside:
        """The same with columns that are combinations: [W | Y] change (p + 1, p' + 1), where Y stays what it is."""
        own = change[:-1, :-1]
        turning = None if self.turning is None else self.turning.combined(change)
        upper, lower = self.upper @ own, self.lower @ own
        return replace(self, turning=turning, partial=self.partial.combined(change), upper=upper, lower=lower)


def distance_to_band(y: FloatArray, one: FloatArray, other: FloatArray) -> FloatArray:
    """Signed distance of y to the band between `one` and `other`, any shape; zero inside."""
    return np.asarray(y - np.clip(y, np.minimum(one, other), np.maximum(one, other)))


def beside_all(parts: Sequence[Beside | None]) -> Beside | None:
    """What is beside one equation in several recordings; None where one of them does not say."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts) or not known:
        return None
    turning = [part.turning for part in known if part.turning is not None]
    return Beside(
        turning=Apart.joined(turning) if len(turning) == len(known) else None,
        partial=Apart.joined([part.partial for part in known]),
        upper=np.concatenate([part.upper for part in known]),
        lower=np.concatenate([part.lower for part in known]),
        y=np.concatenate([part.y for part in known]),
        weights=np.concatenate([part.weights for part in known]),
    )


class BesideAccumulator:
    """Collects what is beside one equation with p columns, as it comes."""

    def __init__(self, n_columns: int) -> None:
        self._p = n_columns
        self._partial = Apart(np.zeros((n_columns + 1, n_columns + 1)), 0)
        self._parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []

    def push_partial(self, rows: FloatArray) -> None:
        """Add rows of [W | Y] (m, p + 1) of the motion beside a halt."""
        self._partial = _with_rows(self._partial, rows)

    def push_standing(self, upper: FloatArray, lower: FloatArray, y: FloatArray) -> None:
        """Add rows at rest: W (m, p) with the friction of either direction, and what was measured (m,)."""
        if len(y):
            self._parts.append((upper, lower, y))

    def finish(self) -> Beside:
        """All that was collected."""
        parts = self._parts or [(np.zeros((0, self._p)), np.zeros((0, self._p)), np.zeros(0))]
        upper, lower, y = (np.concatenate(items) for items in zip(*parts, strict=True))
        every = -(-len(y) // MOST) if len(y) else 1
        weights = np.full(len(y[::every]), len(y) / max(len(y[::every]), 1))
        kept = upper[::every], lower[::every], y[::every]
        return Beside(None, self._partial, *kept, weights)


def _with_rows(known: Apart, rows: FloatArray) -> Apart:
    if not len(rows):
        return known
    return Apart(squared(triangular(np.concatenate([known.factor, rows]))), known.count + len(rows))
