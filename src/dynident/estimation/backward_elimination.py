"""Essential parameters: remove the least significant parameter until all are well determined.

Holds the ratio of standard deviations (10) and the significance level (0.05) at which it ends.

The parameter with the largest relative standard deviation is set to zero and the others are estimated again. This
repeats until the relative standard deviations are within a factor of ten of one another (the chapter's rule for a well
identified parameter, §12.7), or until the noise cannot explain what was removed.

The test counts independent samples, not rows: what was removed so far is compared with its own covariance in the full
model; χ_Sᵀ C_SS⁻¹ χ_S / |S| is distributed as F(|S|, effective rows - parameters) where the truth is zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtrc

from dynident.array_types import FloatArray, IndexArray
from dynident.estimation.least_squares import (
    build_weighted_factor,
    move_held_columns,
)
from dynident.estimation.parameter_covariance import Statistics
from dynident.estimation.prior_information import Solution, extract_deviations, invert_information
from dynident.estimation.qr_decomposition import compute_r_factor
from dynident.estimation.triangular_factors import Reduction

Stop = Literal["ratio", "test", "last"]

WELL_IDENTIFIED_RATIO = 10.0
"""Ratio of the largest to the smallest relative standard deviation at which the elimination ends."""

ELIMINATION_LEVEL = 0.05
"""Significance level of the test: the elimination ends if noise alone would explain more rarely what was removed."""


@dataclass(frozen=True, eq=False)
class Elimination:
    """One step of the elimination: one parameter is removed.

    Parameters
    ----------
    removed : int
        Number of the parameter.
    relative_deviation : float
        Its relative standard deviation before the step.
    ratio : float
        Ratio of the largest to the smallest relative standard deviation before the step.
    statistic, p_value : float
        F test of everything that is removed so far, this parameter included.
    values : (c,)
        All parameters after the step, zero where removed.
    """

    removed: int
    relative_deviation: float
    ratio: float
    statistic: float
    p_value: float
    values: FloatArray


@dataclass(frozen=True, eq=False)
class EliminationPath:
    """The steps of an elimination in their order, and why they end.

    Parameters
    ----------
    eliminations : tuple of Elimination
        The steps that were taken, first to last.
    stop : {"ratio", "test", "last"}
        "ratio" where the rule of ten is met, "test" where the next step would remove more than noise, "last" where one
        parameter is left.
    ratio : float
        Ratio of the relative standard deviations at the end.
    refused : Elimination or None
        The step that failed the test.
    """

    eliminations: tuple[Elimination, ...]
    stop: Stop
    ratio: float
    refused: Elimination | None

    @property
    def removed(self) -> tuple[int, ...]:
        """Numbers of the removed parameters, in the order of their removal."""
        return tuple(step.removed for step in self.eliminations)


def eliminate_parameters(
    reduction: Reduction,
    solution: Solution,
    uncertainty: Statistics,
    ratio: float = WELL_IDENTIFIED_RATIO,
    level: float = ELIMINATION_LEVEL,
) -> EliminationPath:
    """Remove parameters from a solved model, one at a time.

    Weights, residual noise and its correlation stay those of the full model, so that every step is small algebra on
    one triangular factor.

    Parameters
    ----------
    reduction, solution, uncertainty : Reduction, Solution, Statistics
        The data, the full model's solution and its statistics.
    ratio : float
        Ratio of relative standard deviations to reach (the ten of the rule of ten).
    level : float
        Significance level of the test on what is removed.

    Returns
    -------
    EliminationPath
        The steps in their order, and why they end.
    """
    # Parameters that are held at a known value are no candidates: their torque is on the right-hand side.
    own = np.flatnonzero(~solution.is_held)
    r = move_held_columns(build_weighted_factor(reduction, solution.noise, solution.known), solution.known)
    c = len(own)
    freedom = max(float(uncertainty.effective_rows.sum()) - c, 1.0)
    gram = r[:c, :c].T @ r[:c, :c]
    # The sandwich's inner matrix, recovered from the covariance: smaller models take their block of it.
    meat = gram @ uncertainty.covariance[np.ix_(own, own)] @ gram
    remaining = np.arange(c)
    full, full_covariance = _fit_subset(r, remaining, meat)
    values, covariance = full, full_covariance
    eliminations: list[Elimination] = []
    while True:
        relative = _compute_relative_deviations(values, covariance)
        # The rule of ten: a parameter whose relative deviation is ten times the smallest one is poorly identified
        # [§12.7].
        spread = _compute_deviation_ratio(relative)
        if spread < ratio:
            return EliminationPath(tuple(eliminations), "ratio", spread, None)
        if len(remaining) <= 1:
            return EliminationPath(tuple(eliminations), "last", spread, None)
        worst = int(np.argmax(relative))
        removed = np.setdiff1d(np.arange(c), np.delete(remaining, worst))
        # The test is on the full model's estimates, so that earlier steps do not bias it.
        test = compute_wald_test(full[removed], full_covariance[np.ix_(removed, removed)], freedom)
        rest = np.delete(remaining, worst)
        smaller, smaller_covariance = _fit_subset(r, rest, meat)
        padded_values = np.zeros(c)
        padded_values[rest] = smaller
        step = Elimination(
            int(own[remaining[worst]]),
            float(relative[worst]),
            spread,
            test.statistic,
            test.p_value,
            padded_values if solution.known is None else solution.known.restore_held(padded_values),
        )
        if step.p_value < level:
            return EliminationPath(tuple(eliminations), "test", spread, step)
        eliminations.append(step)
        remaining, values, covariance = rest, smaller, smaller_covariance


def _fit_subset(r: FloatArray, remaining: IndexArray, meat: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the values (k,) of the remaining parameters alone, and their covariance (k, k)."""
    # Columns taken out of the full factor: its QR decomposition solves the smaller model without the data.
    small = compute_r_factor(r[:, [*remaining, r.shape[1] - 1]])
    k = len(remaining)
    bread = invert_information(small[:k, :k])
    return solve_triangular(small[:k, :k], small[:k, k]), bread @ meat[np.ix_(remaining, remaining)] @ bread


def _compute_relative_deviations(values: FloatArray, covariance: FloatArray) -> FloatArray:
    return extract_deviations(covariance) / np.maximum(np.abs(values), np.finfo(float).tiny)


def _compute_deviation_ratio(relative: FloatArray) -> float:
    smallest = float(relative.min(initial=np.inf))
    return float(relative.max()) / smallest if 0 < smallest < np.inf else 1.0


@dataclass(frozen=True)
class WaldTest:
    """F test of whether several estimates are zero but for noise.

    Parameters
    ----------
    statistic : float
        χᵀ C⁻¹ χ / q of the q estimates with the covariance C; less where C is from few blocks.
    p_value : float
        Probability that noise alone makes it as large.
    count : int
        Their number q.
    freedom : float
        Degrees of freedom with which their variance is known.
    """

    statistic: float
    p_value: float
    count: int
    freedom: float


def compute_wald_test(
    values: FloatArray, covariance: FloatArray, freedom: float, *, from_blocks: bool = False
) -> WaldTest:
    """Test whether estimates are zero but for noise.

    Parameters
    ----------
    values : (q,)
        The estimates.
    covariance : (q, q)
        Their covariance.
    freedom : float
        Degrees of freedom with which their variance is known.
    from_blocks : bool
        Whether each entry of the covariance is an estimate of its own, from one more block than these degrees of
        freedom: then this is Hotelling's T².

    Returns
    -------
    WaldTest
        The statistic, and how probable it is without an effect.
    """
    rest = freedom - len(values) + 1 if from_blocks else freedom
    # Scaled by the estimates' own deviations, to limit rounding.
    deviations = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    scaled = values / deviations
    square = scaled @ np.linalg.lstsq(covariance / np.outer(deviations, deviations), scaled, rcond=1e-12)[0]
    statistic = float(square) / len(values) * rest / freedom
    return WaldTest(statistic, float(fdtrc(len(values), rest, max(statistic, 0.0))), len(values), rest)
