"""How far estimates move when stretches of time are drawn anew: a check of what is told without drawing.

Few stretches (below thirty) are best drawn by the wild cluster bootstrap: the residuals of each keep their place and
take a random weight, one for a stretch across all equations (Cameron, Gelbach and Miller 2008), of six values (Webb
2014: two would give too few different draws), with the leverage of each stretch taken out of its residuals (MacKinnon,
Nielsen and Webb 2023). Of many, whole stretches are drawn with replacement (pairs). In every draw the equations are
weighed anew. Nothing is read again: the stretches' factors are all there is to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynident.arrays import FloatArray
from dynident.estimation.clusters import occupied, without_leverage
from dynident.estimation.factors import Reduction
from dynident.estimation.least_squares import Solution

Drawing = Literal["wild", "pairs"]

MANY = 30
"""Stretches of time from which pairs are drawn: of fewer, too many draws lack what some parameter is told by."""

DRAWS = 999

_WEBB = np.sqrt([0.5, 1.0, 1.5])
_ROUNDS = 3
_LOST = 0.02
"""Share of what is known in some direction that a draw has to keep."""


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Standard deviations (c,) of estimates over draws, of which `lost` did not determine all parameters."""

    deviations: FloatArray
    kind: Drawing
    draws: int
    lost: int


def bootstrap(
    reduction: Reduction,
    solution: Solution,
    *,
    kind: Drawing | None = None,
    draws: int = DRAWS,
    seed: int = 0,
    reweigh: bool = True,
) -> Bootstrap:
    """Draw stretches of time anew and solve from their factors.

    Parameters
    ----------
    reduction, solution : the data and the estimate
    kind : optional
        By the number of stretches where it is left out.
    reweigh : bool
        Whether the noise of every equation is estimated in each draw.

    Notes
    -----
    In coordinates d with χ = χ̂ + root d, in which WᵀW is one, everything a draw needs is Σ over stretches of what each
    knows of d, of its scores and of its squared residuals, equation by equation.
    """
    parts = _Parts.of(reduction, solution)
    kind = kind or ("wild" if len(parts.squares) < MANY else "pairs")
    rng = np.random.default_rng(seed)
    one = parts.wild if kind == "wild" else parts.pairs
    found = [one(rng, reweigh) for _ in range(draws)]
    kept = np.array([d for d in found if d is not None]).reshape(-1, solution.root.shape[1])
    moved = kept @ solution.root.T
    deviations = moved.std(axis=0, ddof=1) if len(kept) > 1 else np.full(len(solution.values), np.nan)
    return Bootstrap(deviations, kind, draws, draws - len(kept))


@dataclass(frozen=True, eq=False)
class _Parts:
    """What every stretch s and equation e knows: A (s, e, f, f), g (s, e, f), ||ρ||² (s, e), rows (s, e); weighted.

    `known` (k, f) are rows known beside the data and `off` (k,) what the estimate leaves of them. `straight` and
    `straight_squares` are g and ||ρ||² with the leverage taken out.
    """

    information: FloatArray
    scores: FloatArray
    squares: FloatArray
    counts: FloatArray
    known: FloatArray
    off: FloatArray
    straight: FloatArray
    straight_squares: FloatArray

    @classmethod
    def of(cls, reduction: Reduction, solution: Solution) -> _Parts:
        root = solution.root
        f, s, n = root.shape[1], reduction.n_stretches, len(reduction.equations)
        information, scores = np.zeros((s, n, f, f)), np.zeros((s, n, f))
        squares, counts = np.zeros((s, n)), np.zeros((s, n))
        for e, (equation, sigma) in enumerate(zip(reduction.equations, solution.noise, strict=True)):
            if not len(equation.counts):
                continue
            w = equation.factors[:, :, :-1] @ (root[equation.columns] / sigma)
            rests = equation.factors[:, :, -1] - equation.factors[:, :, :-1] @ solution.values[equation.columns]
            rests = rests / sigma
            information[:, e] = w.transpose(0, 2, 1) @ w
            scores[:, e] = np.einsum("sm,smf->sf", rests, w)
            squares[:, e] = (rests**2).sum(axis=1)
            counts[:, e] = equation.counts
        filled = occupied(reduction)
        information, scores, squares, counts = information[filled], scores[filled], squares[filled], counts[filled]
        u = np.einsum("sij,sj->si", without_leverage(information.sum(axis=1)), scores.sum(axis=1))
        moved = np.einsum("seij,sj->sei", information, u)
        straight = scores + moved
        longer = squares + 2 * np.einsum("sei,si->se", scores, u) + np.einsum("sei,si->se", moved, u)
        known, off = np.zeros((0, f)), np.zeros(0)
        if solution.known is not None:
            known = solution.known.factor @ root
            off = solution.known.right - solution.known.factor @ solution.values
        return cls(information, scores, squares, counts, known, off, straight, longer)

    def wild(self, rng: np.random.Generator, reweigh: bool) -> FloatArray | None:
        """The change d (f,) in a draw of weights for the residuals of all stretches."""
        v = rng.choice(np.concatenate([-_WEBB, _WEBB]), size=len(self.squares))
        squares = v**2 @ self.straight_squares
        usual = self.straight_squares.sum(axis=0)
        prior = self.known.T @ rng.standard_normal(len(self.known))
        return self._solved(
            self.information.sum(axis=0), np.tensordot(v, self.straight, 1), squares, usual, prior, reweigh
        )

    def pairs(self, rng: np.random.Generator, reweigh: bool) -> FloatArray | None:
        """The change d (f,) in a draw of stretches with replacement; None where it does not determine all."""
        s = len(self.squares)
        m = np.bincount(rng.integers(s, size=s), minlength=s).astype(np.float64)
        usual = self.squares.sum(axis=0) * (m @ self.counts) / np.maximum(self.counts.sum(axis=0), 1.0)
        prior = self.known.T @ (self.off + rng.standard_normal(len(self.known)))
        information = np.tensordot(m, self.information, 1)
        return self._solved(information, np.tensordot(m, self.scores, 1), m @ self.squares, usual, prior, reweigh)

    def _solved(
        self,
        information: FloatArray,
        scores: FloatArray,
        squares: FloatArray,
        usual: FloatArray,
        prior: FloatArray,
        reweigh: bool,
    ) -> FloatArray | None:
        """Least squares of A (e, f, f), g (e, f), by turns with the weights of the equations where they are weighed."""
        own = self.known.T @ self.known
        weights: FloatArray = np.ones(len(squares))
        d: FloatArray = np.zeros(len(own))
        for _ in range(_ROUNDS if reweigh else 1):
            matrix = np.tensordot(weights, information, 1) + own
            if np.linalg.eigvalsh(matrix)[0] < _LOST * float(weights.min()):
                return None
            d = np.asarray(np.linalg.solve(matrix, weights @ scores + prior), dtype=np.float64)
            left = squares - 2.0 * scores @ d + np.einsum("eij,i,j->e", information, d, d)
            weights = np.asarray(np.where((usual > 0) & (left > 0), usual / np.where(left > 0, left, 1.0), 1.0))
        return np.asarray(d)
