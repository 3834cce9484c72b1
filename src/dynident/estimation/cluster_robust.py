"""Cluster-robust covariance of estimates: blocks of time are the clusters, across all equations.

What a model lacks, and what shakes an arm, shows in the torques of all joints at once and lasts for a while. So whole
blocks of time are assumed to be independent, and nothing within them, across all equations. The estimate without each
block in turn shows how far it depends on what happened there (the jackknife over clusters, CR3 of Bell and McCaffrey
2002; MacKinnon, Nielsen and Webb 2023). Few blocks determine a variance poorly: Student's t uses the degrees of freedom
that Satterthwaite's rule gives for every parameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.estimation.factors import Reduction
from dynident.estimation.least_squares import Solution

FEWEST_CLUSTERS = 5
"""Smallest number of blocks for the jackknife. Fewer say nothing of how the estimate depends on them."""

_ALONE = 0.95
"""Largest share of the information in some direction that one block may hold. Above it, the other blocks cannot tell
how far off that block is, and the direction is taken to be as uncertain as the others are on average.
"""

# Largest number of degrees of freedom: as good as infinite to Student's t.
_SURE = 1e6


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


def estimate_cluster_covariance(
    reduction: Reduction, solution: Solution, scores: FloatArray | None = None
) -> ClusterCovariance:
    """Estimate how far the estimates move when blocks of time are left out, of all equations together.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The data and the estimate from it.
    scores : (s, f), optional
        Scores of the equations that the estimate solves where these are not Wᵀρ = 0 (instrumental variables), times
        `solution.root`.

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
    informations = _compute_informations(reduction, solution, root)
    if scores is None:
        scores = _compute_scores(reduction, solution) @ root
    # A block in which all joints stood has no score. It would only raise the number of clusters.
    filled = find_occupied_blocks(reduction)
    scores, informations = scores[filled], informations[filled]
    count, size = scores.shape
    amplified, dominated = _leave_out_blocks(informations)
    steps = np.einsum("sij,sj->si", amplified, scores)
    inner = (count - 1) / count * steps.T @ steps
    # Directions that only one block determines get the average variance of the others, but no less than independent
    # rows would have.
    average_variance = float(np.trace(inner)) / max(size - float(np.trace(dominated)), 1.0)
    assumed = max(average_variance, _compute_row_variance(reduction, solution)) * dominated
    known = np.zeros((size, size))
    if solution.known is not None:
        rows = solution.known.factor @ root
        known = rows.T @ rows
    covariance = root @ (inner + assumed + known) @ root.T
    # In these coordinates a parameter is a linear form. Forms of unit length give variances of about one, whatever the
    # parameter's unit; their ratio alone matters for the degrees of freedom.
    directions = root / np.maximum(np.linalg.norm(root, axis=1), np.finfo(float).tiny)[:, None]
    variances = [np.einsum("ki,ij,kj->k", directions, part, directions) for part in (inner, assumed, known)]
    from_steps, from_assumption, from_knowledge = (np.maximum(part, 0.0) for part in variances)
    # Of a sum of variances (Welch): what was known is certain, what is guessed as uncertain as can be.
    doubt = (
        from_steps**2 / np.maximum(_compute_satterthwaite_freedom(informations, amplified, directions), 1.0)
        + from_assumption**2
    )
    freedom = (from_steps + from_assumption + from_knowledge) ** 2 / np.maximum(doubt, np.finfo(float).tiny)
    return ClusterCovariance(0.5 * (covariance + covariance.T), np.clip(freedom, 1.0, _SURE))


def find_occupied_blocks(reduction: Reduction) -> BoolArray:
    """Return (s,): which blocks of time have any row in them; in the others all joints stood still."""
    counts = [equation.counts for equation in reduction.equations if len(equation.counts)]
    return np.asarray(np.sum(counts, axis=0) > 0) if counts else np.zeros(reduction.n_blocks, dtype=bool)


def _compute_row_variance(reduction: Reduction, solution: Solution) -> float:
    """Return the mean square of the residuals in units of the noise: the variance if rows were independent."""
    squares = sum(
        float(equation.sum_squares(solution.values).sum()) / float(sigma) ** 2
        for equation, sigma in zip(reduction.equations, solution.noise, strict=True)
        if len(equation.counts)
    )
    return squares / max(reduction.n_rows - reduction.n_columns, 1)


def _compute_scores(reduction: Reduction, solution: Solution) -> FloatArray:
    """Return W_sᵀρ_s of every block (s, c), each equation in units of its noise."""
    scores = np.zeros((reduction.n_blocks, reduction.n_columns))
    for equation, sigma in zip(reduction.equations, solution.noise, strict=True):
        if not len(equation.counts):
            continue
        w = equation.factors[:, :, :-1]
        rests = equation.factors[:, :, -1] - w @ solution.values[equation.columns]
        scores[:, equation.columns] += (rests[:, None, :] @ w)[:, 0] / sigma**2
    return scores


def _compute_informations(reduction: Reduction, solution: Solution, root: FloatArray) -> FloatArray:
    """Return rootᵀ A_s root of every block (s, f, f)."""
    f = root.shape[1]
    informations = np.zeros((reduction.n_blocks, f, f))
    for equation, sigma in zip(reduction.equations, solution.noise, strict=True):
        if not len(equation.counts):
            continue
        rows = equation.factors[:, :, :-1] @ (root[equation.columns] / sigma)
        informations += rows.transpose(0, 2, 1) @ rows
    return informations


def _leave_out_blocks(informations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (1 - A_s)⁻¹ (s, f, f) of every block, and Σ v vᵀ (f, f) of directions v that only one block determines."""
    s, f, _ = informations.shape
    away, alone = np.zeros((s, f, f)), np.zeros((f, f))
    # The Frobenius norm bounds the largest eigenvalue, so only the few blocks above the limit need an
    # eigendecomposition.
    many = np.sqrt((informations**2).sum(axis=(1, 2))) > _ALONE
    away[~many] = np.linalg.inv(np.eye(f) - informations[~many])
    values, vectors = np.linalg.eigh(informations[many])
    lost = values > _ALONE
    # A direction that is dominated by this block is dropped from the jackknife step; its 1 / (1 - λ) would explode.
    amplification = np.where(lost, 0.0, 1.0 / (1.0 - np.minimum(values, _ALONE)))
    away[many] = (vectors * amplification[:, None, :]) @ vectors.transpose(0, 2, 1)
    dominated = (vectors * lost[:, None, :]) @ vectors.transpose(0, 2, 1)
    return away, alone + dominated.sum(axis=0)


def remove_leverage(informations: FloatArray) -> FloatArray:
    """Return (1 - A_s)⁻¹ (s, f, f) for A_s (s, f, f): it undoes the pull of each block on its own residuals."""
    return _leave_out_blocks(informations)[0]


def _compute_satterthwaite_freedom(informations: FloatArray, away: FloatArray, directions: FloatArray) -> FloatArray:
    """Return the degrees of freedom (c,) of the variance along directions (c, f), for independent unit residuals.

    With u_s = (1 - A_s)⁻¹ l the steps lᵀd_s have the covariance Ω = δ u_sᵀA_s u_s - u_sᵀA_s A_t u_t: (tr Ω)² / tr Ω².
    """
    u = away @ directions.T
    v = informations @ u
    own = np.einsum("sik,sik->sk", u, v)
    size = np.einsum("sik,sik->sk", v, v)
    trace = (own - size).sum(axis=0)
    stacked = v.transpose(2, 0, 1)
    overlap = stacked @ stacked.transpose(0, 2, 1)
    # tr Ω² of a diagonal matrix minus a Gram matrix, without forming the (s, s) matrix: the square of the diagonal, the
    # cross term and the square of the Gram matrix.
    squares = (own**2 - 2.0 * own * size).sum(axis=0) + (overlap**2).sum(axis=(1, 2))
    return np.asarray(trace**2 / np.maximum(squares, np.finfo(float).tiny))
