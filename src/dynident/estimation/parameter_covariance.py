"""Covariance, standard deviations and confidence intervals of estimates with correlated residuals [12.6]-[12.10].

Cluster-robust (jackknife over blocks); holds when a prior dominates a parameter.

[12.6] assumes independent residuals. Rows that passed a low-pass filter are not, and model errors even less: counting
them all would promise standard deviations several times too small. There are three covariances, as in regression
with clustered data elsewhere:

by_time_and_joints
    Blocks of time are independent, nothing within them is, across all equations. What a model lacks, and what shakes an
    arm, shows in the torques of all joints at once and lasts for a while. The estimate without each block in turn shows
    how far it depends on what happened there (the jackknife over clusters, CR3 of Bell and McCaffrey 2002; MacKinnon,
    Nielsen and Webb 2023). Few blocks determine a variance poorly: Student's t uses the degrees of freedom that
    Satterthwaite's rule gives for every parameter.
by_joint
    The same, but blocks of different equations are independent, too: what the joints share is left out.
independent
    [12.6] as it stands: every row counts.

Where one number has to do, for weights and for sums over many parameters, the correlation within an equation is
measured from the sums of Wᵀρ over blocks of time. The squares of these sums have a known size for independent
residuals; the excess is the factor by which the number of rows overstates the information (Liang and Zeger 1986, pooled
over the parameters).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.special import stdtrit

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.estimation.least_squares import build_weighted_factor, compute_correlated_noise
from dynident.estimation.prior_information import Solution, extract_deviations
from dynident.estimation.residual_correlation import (
    FEWEST_BLOCKS,
    compute_correlation_factors,
    compute_rests,
    compute_sandwich_covariance,
    compute_scores,
    count_growth_worth,
    join_dependent_blocks,
    widen_for_neighbours,
)
from dynident.estimation.residual_errors import compute_residual_noise
from dynident.estimation.triangular_factors import Reduction

CovarianceName = Literal["by_time_and_joints", "by_joint", "independent"]

_ALONE = 0.95
"""Largest share of the information in some direction that one block may hold. Above it, the other blocks cannot tell
how far off that block is, and the direction is taken to be as uncertain as the others are on average.
"""

# Numbers in what blocks that are left out at once take: a few arrays of that size stay in the cache.
_MOST_NUMBERS = 2**19

MOST_FREEDOM = 1e6
"""Largest number of degrees of freedom: as good as infinite to Student's t."""


@dataclass(frozen=True, eq=False)
class ClusterCovariance:
    """Covariance of estimates from their spread over blocks of time.

    Parameters
    ----------
    covariance : (c, c)
        Covariance of the estimation error.
    freedom : (c,)
        Degrees of freedom with which the variance of each estimate is known.
    """

    covariance: FloatArray
    freedom: FloatArray


def has_enough_blocks(reduction: Reduction, kind: CovarianceName) -> bool:
    """Return whether the spread of estimates over blocks of time is to be taken, and enough blocks have rows.

    Blocks of time count, whichever equation has rows in them: an equation with few of its own has few degrees of
    freedom, and takes none from the others.

    Parameters
    ----------
    reduction, kind : Reduction, CovarianceName
        The data, and the covariance that is asked for.
    """
    return kind != "independent" and int(find_occupied_blocks(reduction).sum()) >= FEWEST_BLOCKS


def _group_equations(reduction: Reduction, kind: CovarianceName) -> list[tuple[IndexArray, Reduction]]:
    """Return equations whose blocks of the same time depend on each other: their numbers, and their data.

    All equations are one group, or each of them is one. Equations without rows are in none.
    """
    filled = np.flatnonzero(reduction.row_counts)
    groups = []
    for numbers in [filled] if kind == "by_time_and_joints" else list(filled[:, None]):
        equations = tuple(reduction.equations[k] for k in numbers)
        # Equations from runs of their own, as of the friction of one joint, have numbers of blocks of their own.
        n_blocks = max((len(equation.counts) for equation in equations), default=0)
        groups.append((numbers, Reduction(reduction.n_columns, equations, reduction.spans[:n_blocks])))
    return groups


def estimate_cluster_covariance(
    reduction: Reduction,
    solution: Solution,
    kind: CovarianceName = "by_time_and_joints",
    scores: Sequence[FloatArray] | None = None,
    *,
    is_ordered: bool = False,
) -> ClusterCovariance:
    """Estimate how far the estimates move when blocks of time are left out.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The data and the estimate from it.
    kind : {"by_time_and_joints", "by_joint"}
        Whether a block of time is that of all equations together, or of each by itself.
    scores : n of (s, f), optional
        Scores of the blocks of every equation, times `solution.root`, where an estimate does not solve Wᵀρ = 0
        (instrumental variables).
    is_ordered : bool
        Whether neighbouring blocks may depend on each other, see `widen_for_neighbours`.

    Returns
    -------
    ClusterCovariance
        Covariance of the estimates, and how many degrees of freedom it is known with.

    Notes
    -----
    With every equation in units of its noise, g_s = W_sᵀρ_s and A_s = W_sᵀW_s of a block and B = (WᵀW)⁻¹, the
    estimate without it differs by d_s = (B⁻¹ - A_s)⁻¹ g_s; the covariance is (S - 1) / S Σ d_s d_sᵀ. Prior knowledge
    adds its own. All is done in coordinates in which B is one.
    """
    root = solution.root
    size = root.shape[1]
    # In these coordinates a parameter is a linear form. Forms of unit length give variances of about one, whatever the
    # parameter's unit; their ratio alone matters for the degrees of freedom.
    directions = root / np.maximum(np.linalg.norm(root, axis=1), np.finfo(float).tiny)[:, None]
    steps, dominated = [np.zeros((0, size))], np.zeros((size, size))
    pulls, moved = [np.zeros((0, len(root)))], [np.zeros((0, size, len(root)))]
    together = max(1, _MOST_NUMBERS // max(size, 1) ** 2)
    if scores is None:
        scores = [
            compute_scores(e.factors[:, :, :-1], compute_rests(e, solution.values)) @ (root[e.columns] / sigma**2)
            for e, sigma in zip(reduction.equations, solution.noise, strict=True)
        ]
    followed: list[FloatArray] = []
    for numbers, part in _group_equations(reduction, kind):
        first_step = len(steps)
        together_scores = np.zeros((part.n_blocks, size))
        for k in numbers:
            together_scores[: len(scores[k])] += scores[k]
        # A block in which no equation has rows has no score. It would only raise the number of clusters.
        filled = np.flatnonzero(find_occupied_blocks(part))
        for first in range(0, len(filled), together):
            where = filled[first : first + together]
            informations = _compute_informations(part, solution.noise[numbers], root, where)
            right = np.empty((len(informations), size, 1 + len(root)))
            right[:, :, 0], right[:, :, 1:] = together_scores[where], directions.T
            amplified, alone = _leave_out_blocks(informations, right)
            dominated += alone
            u = amplified[:, :, 1:]
            steps.append(amplified[:, :, 0])
            moved.append(informations @ u)
            pulls.append(np.einsum("sik,sik->sk", u, moved[-1]))
        followed.append(np.concatenate([np.zeros((0, size)), *steps[first_step:]]))
    each = np.concatenate(steps)
    independent = (len(each) - 1) / len(each) * each.T @ each
    inner = widen_for_neighbours(independent, followed, directions) if is_ordered else independent
    # Directions that only one block determines get the average variance of the others, but no less than independent
    # rows would have.
    average_variance = float(np.trace(inner)) / max(size - float(np.trace(dominated)), 1.0)
    assumed = max(average_variance, _compute_row_variance(reduction, solution)) * dominated
    known = np.zeros((size, size))
    if solution.known is not None:
        rows = solution.known.factor @ root
        known = rows.T @ rows
    covariance = root @ (inner + assumed + known) @ root.T
    variances = [np.einsum("ki,ij,kj->k", directions, part, directions) for part in (inner, assumed, known)]
    from_steps, from_assumption, from_knowledge = (np.maximum(part, 0.0) for part in variances)
    # Of a sum of variances (Welch): what was known is certain, what is guessed as uncertain as can be.
    own = _compute_satterthwaite_freedom(np.concatenate(pulls), np.concatenate(moved))
    before = np.einsum("ki,ij,kj->k", directions, independent, directions)
    own *= count_growth_worth(from_steps, before)
    doubt = from_steps**2 / np.maximum(own, 1.0) + from_assumption**2
    freedom = (from_steps + from_assumption + from_knowledge) ** 2 / np.maximum(doubt, np.finfo(float).tiny)
    # A parameter that is held is a constant.
    freedom = np.where(solution.is_held, np.inf, np.clip(freedom, 1.0, MOST_FREEDOM))
    return ClusterCovariance(0.5 * (covariance + covariance.T), freedom)


def find_occupied_blocks(reduction: Reduction) -> BoolArray:
    """Return (s,): which blocks of time have any row in them; the others are empty."""
    occupied = np.zeros(reduction.n_blocks, dtype=bool)
    for equation in reduction.equations:
        occupied[: len(equation.counts)] |= equation.counts > 0
    return occupied


def _compute_row_variance(reduction: Reduction, solution: Solution) -> float:
    """Return the mean square of the residuals in units of the noise: the variance if rows were independent."""
    squares = sum(
        float(equation.sum_squares(solution.values).sum()) / float(sigma) ** 2
        for equation, sigma in zip(reduction.equations, solution.noise, strict=True)
        if len(equation.counts)
    )
    return squares / max(reduction.n_rows - int(np.sum(~solution.is_held)), 1)


def _compute_informations(reduction: Reduction, noise: FloatArray, root: FloatArray, blocks: IndexArray) -> FloatArray:
    """Return rootᵀ A_s root of some blocks (s, f, f)."""
    f = root.shape[1]
    informations = np.zeros((len(blocks), f, f))
    for equation, sigma in zip(reduction.equations, noise, strict=True):
        own = blocks < len(equation.counts)
        rows = equation.factors[blocks[own], :, :-1] @ (root[equation.columns] / sigma)
        informations[own] += rows.transpose(0, 2, 1) @ rows
    return informations


def _leave_out_blocks(informations: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (1 - A_s)⁻¹ times `right` (s, f, k), and Σ v vᵀ (f, f) of directions v that only one block determines."""
    f = informations.shape[1]
    solved, alone = np.zeros(right.shape), np.zeros((f, f))
    # Cholesky's decomposition fails where an eigenvalue is above the limit: only these few blocks need all of them.
    many = np.array([lapack.dpotrf(_ALONE * np.eye(f) - block)[1] > 0 for block in informations], dtype=bool)
    solved[~many] = np.linalg.solve(np.eye(f) - informations[~many], right[~many])
    values, vectors = np.linalg.eigh(informations[many])
    lost = values > _ALONE
    # A direction that is dominated by this block is dropped from the jackknife step; its 1 / (1 - λ) would explode.
    amplification = np.where(lost, 0.0, 1.0 / (1.0 - np.minimum(values, _ALONE)))
    solved[many] = (vectors * amplification[:, None, :]) @ (vectors.transpose(0, 2, 1) @ right[many])
    dominated = (vectors * lost[:, None, :]) @ vectors.transpose(0, 2, 1)
    return solved, alone + dominated.sum(axis=0)


def remove_leverage(informations: FloatArray, scores: FloatArray) -> FloatArray:
    """Return (1 - A_s)⁻¹ g_s (s, f) for A_s (s, f, f): it undoes the pull of each block on its own residuals."""
    return _leave_out_blocks(informations, scores[:, :, None])[0][:, :, 0]


def _compute_satterthwaite_freedom(own: FloatArray, v: FloatArray) -> FloatArray:
    """Return the degrees of freedom (c,) of the variance along directions l (c, f), for independent unit residuals.

    With u_s = (1 - A_s)⁻¹ l the steps lᵀd_s have the covariance Ω = δ u_sᵀA_s u_s - u_sᵀA_s A_t u_t: (tr Ω)² / tr Ω².
    Given are u_sᵀA_s u_s (s, c), and A_s u_s (s, f, c).
    """
    size = np.einsum("sik,sik->sk", v, v)
    trace = (own - size).sum(axis=0)
    # VᵀV and VVᵀ have the same norm; the smaller one is formed.
    stacked = v.transpose((2, 1, 0) if v.shape[1] < len(v) else (2, 0, 1))
    overlap = stacked @ stacked.transpose(0, 2, 1)
    # tr Ω² of a diagonal matrix minus a Gram matrix, without forming the (s, s) matrix: the square of the diagonal, the
    # cross term and the square of the Gram matrix.
    squares = (own**2 - 2.0 * own * size).sum(axis=0) + (overlap**2).sum(axis=(1, 2))
    return np.asarray(trace**2 / np.maximum(squares, np.finfo(float).tiny))


# Singular values below this share of the largest count as zero; a parameter with more than so much of an undetermined
# direction in it counts as undetermined.
_NULL, _LOOSE = 1e-9, 1e-5
# More than so many times as sure as by the data alone: three quarters of what is known come from elsewhere.
_OWED = 2.0


def compute_standard_deviations(rows: FloatArray, held: FloatArray | None = None) -> FloatArray:
    """Return the standard deviations (c,) of parameters that rows determine.

    Parameters
    ----------
    rows : (r, c)
        Rows of W in units of their noise.
    held : (h, c), optional
        Directions that constraints hold, taken as certain.

    Returns
    -------
    (c,) array
        Infinite where a parameter is left undetermined.
    """
    # Columns of unit length: the threshold for singular values must not depend on the parameters' units.
    size = np.linalg.norm(rows, axis=0)
    size = np.where(size > 0, size, 1.0)
    scaled = rows / size
    moving = np.eye(rows.shape[1]) if held is None or not len(held) else compute_null_space(held / size)
    _, singular, vt = np.linalg.svd(scaled @ moving, full_matrices=True)
    enough = singular > _NULL * max(float(singular.max(initial=0.0)), np.finfo(float).tiny)
    count = int(np.count_nonzero(enough))
    determined = moving @ (vt[:count].T / singular[:count])
    # A parameter counts as undetermined as soon as an undetermined direction contains it by more than rounding.
    loose = np.abs(moving @ vt[count:].T).max(axis=1, initial=0.0) > _LOOSE
    return np.asarray(np.where(loose, np.inf, np.linalg.norm(determined, axis=1) / size))


def compute_null_space(rows: FloatArray, size: float = float(np.finfo(float).tiny)) -> FloatArray:
    """Return orthonormal directions that rows map to zero.

    A singular value counts as zero when it is small compared to the largest one, or to `size` where that is larger.

    Parameters
    ----------
    rows : (h, c)
        The rows.
    size : float
        Lower bound of the scale that singular values are compared to.

    Returns
    -------
    (c, k) array
        One direction a column.
    """
    _, singular, vt = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.count_nonzero(singular > _NULL * max(float(singular.max(initial=0.0)), size)))
    return np.asarray(vt[rank:].T)


def find_prior_dominated(reduction: Reduction, solution: Solution) -> NDArray[np.bool_]:
    """Return which parameters rest on prior knowledge rather than on the data.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.
    solution : Solution
        The estimate from these data.

    Returns
    -------
    (c,) array of bool
        True where the data alone would leave more than twice the standard deviation.
    """
    if solution.known is None:
        return np.zeros(len(solution.values), dtype=bool)
    noise = compute_correlated_noise(reduction, solution)
    c = reduction.n_columns
    # The noise is corrected for correlated rows, as it is where prior knowledge is weighed against the data.
    held = np.eye(c)[solution.known.is_held]
    alone = compute_standard_deviations(build_weighted_factor(reduction, noise)[:c, :c], held)
    together = compute_standard_deviations(build_weighted_factor(reduction, noise, solution.known)[:c, :c], held)
    return np.asarray(alone > _OWED * together)


NORMAL_95 = 1.96
"""Standard deviations on either side that hold a normally distributed error with a probability of 95 %."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Uncertainty of a solution.

    Parameters
    ----------
    covariance : (c, c)
        Of the estimation error, [12.8].
    effective_rows : (n,)
        Number of independent samples that each equation's rows are worth.
    noise : (n,)
        Standard deviation of each equation's residual, [12.7].
    freedom : (c,)
        Degrees of freedom with which the variance of each estimate is known.
    """

    covariance: FloatArray
    effective_rows: FloatArray
    noise: FloatArray
    freedom: FloatArray

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations (c,) of the estimates, [12.9]."""
        return extract_deviations(self.covariance)

    @property
    def median_freedom(self) -> float:
        """Median of the degrees of freedom, for quantities that depend on many estimates."""
        estimated = self.freedom[np.isfinite(self.freedom)]
        return float(np.median(estimated)) if len(estimated) else 1.0

    def half_widths(self, level: float = 0.95) -> FloatArray:
        """Return the half-widths (c,) of the intervals that hold the true value with this probability (Student's t)."""
        return np.asarray(stdtrit(self.freedom, 0.5 + 0.5 * level) * self.standard_deviations)

    def prediction_quantiles(self, level: float = 0.95) -> tuple[float, float]:
        """Return the quantiles of Student's t for a predicted torque: of what the parameters and what the noise adds.

        Parameters and noise have different degrees of freedom, so each has a quantile of its own.
        """
        of_parameters, of_noise = stdtrit([self.median_freedom, self.effective_rows.sum()], 0.5 + 0.5 * level)
        return float(of_parameters), float(of_noise)

    def relative_standard_deviations(self, values: FloatArray) -> FloatArray:
        """Return the standard deviations relative to the estimates, [12.10].

        Parameters
        ----------
        values : (c,)
            The estimates.

        Returns
        -------
        (c,) array
            Fractions; infinite for a parameter whose estimate is zero.
        """
        size = np.abs(values)
        relative = np.full(len(size), np.inf)
        np.divide(self.standard_deviations, size, out=relative, where=size > 0)
        return relative


def statistics(reduction: Reduction, solution: Solution, kind: CovarianceName = "by_time_and_joints") -> Statistics:
    """Return the covariance of the estimates with the correlations that `kind` names accounted for.

    Blocks of time that depend on their neighbours are joined before. With fewer than five blocks nothing tells how the
    estimate depends on them, and the statistics are those of `compute_pooled_statistics`.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The data and the estimate from it.
    kind : {"by_time_and_joints", "by_joint", "independent"}
        Which correlations of the residuals are accounted for: within blocks of time across all equations, within each
        equation, or none.

    Returns
    -------
    Statistics
        Covariance, effective numbers of rows, noise and degrees of freedom.
    """
    joined = join_dependent_blocks(reduction, solution)
    if not has_enough_blocks(joined, kind):
        return compute_pooled_statistics(reduction, solution, is_independent=kind == "independent")
    spread = estimate_cluster_covariance(joined, solution, kind, is_ordered=True)
    worth = joined.row_counts / compute_correlation_factors(reduction, solution, joined)
    return Statistics(spread.covariance, worth, compute_residual_noise(reduction, solution.values), spread.freedom)


def compute_pooled_statistics(reduction: Reduction, solution: Solution, *, is_independent: bool = False) -> Statistics:
    """Return the covariance with one correlation factor for all parameters of an equation.

    It has full rank, however few blocks there are, so it can weigh estimates against others. It is too small for a
    parameter that slow residuals resemble, such as an offset, and too large for others.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The data and the estimate from it.
    is_independent : bool
        Whether every row counts for an independent sample, whatever its correlation.
    """
    inflation = compute_correlation_factors(reduction, solution)
    counted = np.ones(len(inflation)) if is_independent else inflation
    freedom = np.full(reduction.n_columns, np.inf)
    freedom[~solution.is_held] = compute_row_freedom(reduction.row_counts / counted, int(np.sum(~solution.is_held)))
    noise = compute_residual_noise(reduction, solution.values)
    covariance = compute_sandwich_covariance(reduction, solution, counted)
    return Statistics(covariance, reduction.row_counts / inflation, noise, freedom)


def compute_row_freedom(independent: FloatArray, n_columns: int) -> FloatArray:
    """Return the degrees of freedom that a fit leaves of independent rows, the same for all parameters.

    Parameters
    ----------
    independent : (n,)
        Number of independent rows of every equation.
    n_columns : int
        Number of parameters c.

    Returns
    -------
    (c,) array
        The same number for every parameter, at least 1.
    """
    return np.full(n_columns, max(float(independent.sum()) - n_columns, 1.0))


def compute_correlations(covariance: FloatArray) -> FloatArray:
    """Return the correlation matrix (c, c) of the estimates."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    return np.asarray(covariance / np.outer(deviation, deviation))
