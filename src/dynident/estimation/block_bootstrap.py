"""Bootstrap of the estimates over blocks of time, to check the computed standard deviations.

Holds the number of draws (999), and from how many blocks pairs are drawn (30).

Few blocks (below thirty) are best drawn by the wild cluster bootstrap: the residuals of each block keep their place and
take a random weight, one per block across all equations (Cameron, Gelbach and Miller 2008), of six values (Webb
2014: two would give too few different draws), with the leverage of each block removed from its residuals (MacKinnon,
Nielsen and Webb 2023). Of many blocks, whole ones are drawn with replacement (pairs). Every draw estimates the weights
of the equations again. No data is read again: the factors of the blocks hold all that is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation.parameter_covariance import find_occupied_blocks, remove_leverage
from dynident.estimation.prior_information import Solution
from dynident.estimation.triangular_factors import Reduction

Drawing = Literal["wild", "pairs"]

FEWEST_BLOCKS_FOR_PAIRS = 30
"""Number of blocks from which pairs are drawn. With fewer, too many draws lack a block that some parameter needs."""

DRAWS = 999

# Sizes of Webb's six weights, which come with either sign: mean zero and variance one.
_WEBB = np.sqrt([0.5, 1.0, 1.5])
# Rounds of estimates and weights in a draw: it begins at the weights of the estimate, which are nearly right.
_ROUNDS = 3
_LOST = 0.02
"""Share of what is known in some direction that a draw has to keep."""


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Standard deviations of estimates over bootstrap draws.

    Parameters
    ----------
    deviations : (c,)
        Standard deviation of each parameter over the draws that determined all of them.
    kind : {"wild", "pairs"}
        How blocks were drawn: random weights of their residuals, or whole blocks with replacement.
    draws : int
        Number of draws.
    lost : int
        Number of draws that did not determine all parameters.
    """

    deviations: FloatArray
    kind: Drawing
    draws: int
    lost: int


def bootstrap_estimates(
    reduction: Reduction,
    solution: Solution,
    *,
    kind: Drawing | None = None,
    draws: int = DRAWS,
    seed: int = 0,
    reweigh: bool = True,
) -> Bootstrap:
    """Draw blocks of time at random and solve from their factors.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The data and the estimate from it.
    kind : {"wild", "pairs"}, optional
        How to draw; chosen by the number of blocks where it is left out.
    draws : int
        Number of draws.
    seed : int
        Seed of the random numbers.
    reweigh : bool
        Whether the noise of every equation is estimated again in each draw.

    Returns
    -------
    Bootstrap
        Standard deviations over the draws, and how many draws were lost.

    Notes
    -----
    In coordinates d with χ = χ̂ + root d, in which WᵀW is one, everything a draw needs are sums over blocks: of the
    information that each holds about d, of its scores and of its squared residuals, equation by equation.
    """
    parts = _BlockSums.from_solution(reduction, solution)
    kind = kind or ("wild" if len(parts.squares) < FEWEST_BLOCKS_FOR_PAIRS else "pairs")
    rng = np.random.default_rng(seed)
    draw_change = parts.draw_wild if kind == "wild" else parts.draw_pairs
    changes = [draw_change(rng, reweigh) for _ in range(draws)]
    # Draws that do not determine all parameters are left out of the deviations, and counted as lost.
    determined = np.array([d for d in changes if d is not None]).reshape(-1, solution.root.shape[1])
    estimate_changes = determined @ solution.root.T
    deviations = estimate_changes.std(axis=0, ddof=1) if len(determined) > 1 else np.full(len(solution.values), np.nan)
    return Bootstrap(deviations, kind, draws, draws - len(determined))


@dataclass(frozen=True, eq=False)
class _BlockSums:
    """What each block s contributes in equation e: A (s, e, f, f), g (s, e, f), ||ρ||² (s, e), rows (s, e); weighted.

    `known` (k, f) are rows of prior knowledge and `off` (k,) their residual at the estimate. `straight` and
    `straight_squares` are g and ||ρ||² with the leverage removed.
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
    def from_solution(cls, reduction: Reduction, solution: Solution) -> _BlockSums:
        root = solution.root
        f, s, n = root.shape[1], reduction.n_blocks, len(reduction.equations)
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
        filled = find_occupied_blocks(reduction)
        information, scores, squares, counts = information[filled], scores[filled], squares[filled], counts[filled]
        # A block pulls the estimate towards itself, which shrinks its own residuals. Undo that with (1 - A)⁻¹, as CR3
        # does.
        u = remove_leverage(information.sum(axis=1), scores.sum(axis=1))
        moved = np.einsum("seij,sj->sei", information, u)
        straight = scores + moved
        longer = squares + 2 * np.einsum("sei,si->se", scores, u) + np.einsum("sei,si->se", moved, u)
        known, off = np.zeros((0, f)), np.zeros(0)
        if solution.known is not None:
            known = solution.known.factor @ root
            off = solution.known.right - solution.known.factor @ solution.values
        return cls(information, scores, squares, counts, known, off, straight, longer)

    def draw_wild(self, rng: np.random.Generator, reweigh: bool) -> FloatArray | None:
        """Return the change d (f,) in one draw of random weights for the residuals of all blocks."""
        # One weight for a block across all equations, so that the correlation between them is kept.
        v = rng.choice(np.concatenate([-_WEBB, _WEBB]), size=len(self.squares))
        squares = v**2 @ self.straight_squares
        usual = self.straight_squares.sum(axis=0)
        # Prior knowledge is no block of time: it is redrawn from the normal distribution that it stands for.
        prior = self.known.T @ rng.standard_normal(len(self.known))
        return self._solve_draw(
            self.information.sum(axis=0), np.tensordot(v, self.straight, 1), squares, usual, prior, reweigh
        )

    def draw_pairs(self, rng: np.random.Generator, reweigh: bool) -> FloatArray | None:
        """Return the change d (f,) in one draw of blocks with replacement; None where it does not determine all."""
        s = len(self.squares)
        # Drawing blocks with replacement is the same as weighting each block by the number of times it was drawn.
        m = np.bincount(rng.integers(s, size=s), minlength=s).astype(np.float64)
        usual = self.squares.sum(axis=0) * (m @ self.counts) / np.maximum(self.counts.sum(axis=0), 1.0)
        prior = self.known.T @ (self.off + rng.standard_normal(len(self.known)))
        information = np.tensordot(m, self.information, 1)
        return self._solve_draw(information, np.tensordot(m, self.scores, 1), m @ self.squares, usual, prior, reweigh)

    def _solve_draw(
        self,
        information: FloatArray,
        scores: FloatArray,
        squares: FloatArray,
        usual: FloatArray,
        prior: FloatArray,
        reweigh: bool,
    ) -> FloatArray | None:
        """Solve A (e, f, f), g (e, f) by least squares, in turn with the weights of the equations."""
        prior_information = self.known.T @ self.known
        weights: FloatArray = np.ones(len(squares))
        d: FloatArray = np.zeros(len(prior_information))
        for _ in range(_ROUNDS if reweigh else 1):
            matrix = np.tensordot(weights, information, 1) + prior_information
            # In these coordinates the full data has eigenvalues of one. A draw that keeps hardly any of one direction
            # would give an arbitrary estimate there, so it is counted as lost.
            if np.linalg.eigvalsh(matrix)[0] < _LOST * float(weights.min()):
                return None
            d = np.asarray(np.linalg.solve(matrix, weights @ scores + prior), dtype=np.float64)
            residual_squares = squares - 2.0 * scores @ d + np.einsum("eij,i,j->e", information, d, d)
            # The weight of an equation falls as its residual variance in this draw rises above the variance that is
            # expected.
            weights = np.asarray(
                np.where(
                    (usual > 0) & (residual_squares > 0),
                    usual / np.where(residual_squares > 0, residual_squares, 1.0),
                    1.0,
                )
            )
        return np.asarray(d)
