"""Essential parameters: the few that the data show, by backward elimination [Pham and Gautier 1991].

The parameter with the largest relative standard deviation is set to zero and the others are estimated anew, until the
relative standard deviations are within a factor of ten of one another (the chapter's rule for a well identified
parameter, §12.7), or until what was taken out is more than the noise can explain.

The test counts independent samples, not rows: what was taken out so far, held against its own covariance in the full
model, χ_Sᵀ C_SS⁻¹ χ_S / |S|, is distributed as F(|S|, effective rows - parameters) where the truth is zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtrc

from dynident.arrays import FloatArray, IndexArray
from dynident.estimation.factors import Reduction
from dynident.estimation.information import covariance_of, deviations_of
from dynident.estimation.least_squares import Solution, weighted_factor
from dynident.estimation.statistics import Statistics
from dynident.estimation.triangles import triangular

Stop = Literal["ratio", "test", "last"]

RATIO = 10.0
"""Largest over smallest relative standard deviation at which the elimination ends."""

LEVEL = 0.05
"""Of the test: what is taken out ends the elimination if noise alone would explain it more rarely than this."""


@dataclass(frozen=True, eq=False)
class Elimination:
    """One parameter less: `removed` its number, `relative_deviation` its relative standard deviation before.

    `ratio` of the largest to the smallest relative standard deviation before; `statistic` F and `p_value` of all that
    is then taken out, this one included; `values` (c,) of all parameters afterwards, zero where taken out.
    """

    removed: int
    relative_deviation: float
    ratio: float
    statistic: float
    p_value: float
    values: FloatArray


@dataclass(frozen=True, eq=False)
class EliminationPath:
    """The eliminations in their order, and why they end.

    `stop`: "ratio" where the rule of ten is met, "test" where the next elimination, `refused`, would take out more than
    noise, "last" where one parameter is left. `ratio`: what is left of the ratio.
    """

    eliminations: tuple[Elimination, ...]
    stop: Stop
    ratio: float
    refused: Elimination | None

    @property
    def removed(self) -> tuple[int, ...]:
        """Numbers of the parameters that are taken out, in that order."""
        return tuple(step.removed for step in self.eliminations)


def eliminate(
    reduction: Reduction, solution: Solution, found: Statistics, ratio: float = RATIO, level: float = LEVEL
) -> EliminationPath:
    """Take parameters out of a solved model, one at a time.

    Weights, residual noise and its correlation stay those of the full model, so that every step is small algebra on
    one triangular factor.

    Parameters
    ----------
    reduction, solution, found : the data, the full model's solution and its statistics
    ratio : float
        The rule of ten's ten.
    level : float
        Of the test on what is taken out.
    """
    c = reduction.n_columns
    r = weighted_factor(reduction, solution.noise, solution.known)
    freedom = max(float(found.effective_rows.sum()) - c, 1.0)
    gram = r[:c, :c].T @ r[:c, :c]
    meat = gram @ found.covariance @ gram
    kept = np.arange(c)
    full, full_covariance = _fitted(r, kept, meat)
    values, covariance = full, full_covariance
    taken: list[Elimination] = []
    while True:
        relative = _relative(values, covariance)
        spread = _spread(relative)
        if spread < ratio:
            return EliminationPath(tuple(taken), "ratio", spread, None)
        if len(kept) == 1:
            return EliminationPath(tuple(taken), "last", spread, None)
        worst = int(np.argmax(relative))
        removed = np.array([*(step.removed for step in taken), kept[worst]], dtype=np.intp)
        statistic = _wald(full, full_covariance, removed)
        rest = np.delete(kept, worst)
        smaller, smaller_covariance = _fitted(r, rest, meat)
        everything = np.zeros(c)
        everything[rest] = smaller
        step = Elimination(
            int(kept[worst]),
            float(relative[worst]),
            spread,
            statistic,
            float(fdtrc(len(removed), freedom, max(statistic, 0.0))),
            everything,
        )
        if step.p_value < level:
            return EliminationPath(tuple(taken), "test", spread, step)
        taken.append(step)
        kept, values, covariance = rest, smaller, smaller_covariance


def _fitted(r: FloatArray, kept: IndexArray, meat: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (k,) of these parameters alone, and their covariance (k, k)."""
    small = triangular(r[:, [*kept, r.shape[1] - 1]])
    k = len(kept)
    bread = covariance_of(small[:k, :k])
    return solve_triangular(small[:k, :k], small[:k, k]), bread @ meat[np.ix_(kept, kept)] @ bread


def _relative(values: FloatArray, covariance: FloatArray) -> FloatArray:
    return deviations_of(covariance) / np.maximum(np.abs(values), np.finfo(float).tiny)


def _spread(relative: FloatArray) -> float:
    smallest = float(relative.min())
    return float(relative.max()) / smallest if smallest > 0 else 1.0


def _wald(values: FloatArray, covariance: FloatArray, removed: IndexArray) -> float:
    """χ_Sᵀ C_SS⁻¹ χ_S / |S|, in units of the parameters' own deviations against rounding."""
    block = covariance[np.ix_(removed, removed)]
    deviations = np.sqrt(np.maximum(np.diag(block), np.finfo(float).tiny))
    scaled = values[removed] / deviations
    return float(scaled @ np.linalg.lstsq(block / np.outer(deviations, deviations), scaled, rcond=1e-12)[0]) / len(
        removed
    )
