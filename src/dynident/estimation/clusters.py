"""How sure estimates are where residuals are correlated in time and between equations: stretches of time as clusters.

What a model lacks, and what shakes an arm, is in the torques of all joints at once, and for a while. So whole stretches
of time are taken for independent, and nothing within them, across all equations: the estimate without each of them in
turn shows how far it depends on what happened there (the jackknife over clusters, CR3 of Bell and McCaffrey 2002;
MacKinnon, Nielsen and Webb 2023). From few stretches a variance is not well known: Student's t takes the degrees of
freedom that Satterthwaite's rule finds for every parameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import BoolArray, FloatArray
from dynident.estimation.factors import Reduction
from dynident.estimation.least_squares import Solution

FEWEST_CLUSTERS = 5
"""Fewer stretches say nothing of how the estimate depends on them."""

_ALONE = 0.95
"""Share of all that is known in some direction that one stretch may hold: of more, the others cannot tell how far off
it is, and it counts as uncertain as the other directions are on average."""

_SURE = 1e6


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariance (c, c) of estimates, and the degrees of freedom (c,) that each one's variance is known with."""

    covariance: FloatArray
    freedom: FloatArray


def spread_over_stretches(reduction: Reduction, solution: Solution, scores: FloatArray | None = None) -> Spread:
    """How far the estimates move when stretches of time are left out, of all equations together.

    Parameters
    ----------
    reduction, solution : the data and the estimate
    scores : (s, f), optional
        Those of the equations that the estimate solves, where they are not Wᵀρ = 0, times `solution.root`.

    Notes
    -----
    With every equation in units of its noise, g_s = W_sᵀρ_s and A_s = W_sᵀW_s of a stretch and B = (WᵀW)⁻¹, the
    estimate without it differs by d_s = (B⁻¹ - A_s)⁻¹ g_s; the covariance is (S - 1) / S Σ d_s d_sᵀ. What was known
    beside the data adds its own. All is done in coordinates in which B is one.
    """
    root = solution.root
    informations = _informations(reduction, solution, root)
    if scores is None:
        scores = _scores(reduction, solution) @ root
    filled = occupied(reduction)
    scores, informations = scores[filled], informations[filled]
    count, size = scores.shape
    away, alone = _without(informations)
    steps = np.einsum("sij,sj->si", away, scores)
    inner = (count - 1) / count * steps.T @ steps
    # Whatever one stretch alone tells of: as the other directions are on average, no less than for independent rows.
    usual = float(np.trace(inner)) / max(size - float(np.trace(alone)), 1.0)
    guessed = max(usual, _of_rows(reduction, solution)) * alone
    known = np.zeros((size, size))
    if solution.known is not None:
        rows = solution.known.factor @ root
        known = rows.T @ rows
    covariance = root @ (inner + guessed + known) @ root.T
    directions = root / np.maximum(np.linalg.norm(root, axis=1), np.finfo(float).tiny)[:, None]
    parts = [np.einsum("ki,ij,kj->k", directions, part, directions) for part in (inner, guessed, known)]
    own, alike, rest = (np.maximum(part, 0.0) for part in parts)
    # Of a sum of variances (Welch): what was known is certain, what is guessed as uncertain as can be.
    doubt = own**2 / np.maximum(_satterthwaite(informations, away, directions), 1.0) + alike**2
    freedom = (own + alike + rest) ** 2 / np.maximum(doubt, np.finfo(float).tiny)
    return Spread(0.5 * (covariance + covariance.T), np.clip(freedom, 1.0, _SURE))


def occupied(reduction: Reduction) -> BoolArray:
    """(s,): stretches of time with any row in them; in the others all joints stood."""
    counts = [equation.counts for equation in reduction.equations if len(equation.counts)]
    return np.asarray(np.sum(counts, axis=0) > 0) if counts else np.zeros(reduction.n_stretches, dtype=bool)


def _of_rows(reduction: Reduction, solution: Solution) -> float:
    """Mean square of the residuals in units of the noise: the variance of every direction if rows were independent."""
    squares = sum(
        float(equation.squares(solution.values).sum()) / float(sigma) ** 2
        for equation, sigma in zip(reduction.equations, solution.noise, strict=True)
        if len(equation.counts)
    )
    return squares / max(reduction.n_rows - reduction.n_columns, 1)


def _scores(reduction: Reduction, solution: Solution) -> FloatArray:
    """(s, c): W_sᵀρ_s of every stretch, each equation in units of its noise."""
    found = np.zeros((reduction.n_stretches, reduction.n_columns))
    for equation, sigma in zip(reduction.equations, solution.noise, strict=True):
        if not len(equation.counts):
            continue
        w = equation.factors[:, :, :-1]
        rests = equation.factors[:, :, -1] - w @ solution.values[equation.columns]
        found[:, equation.columns] += (rests[:, None, :] @ w)[:, 0] / sigma**2
    return found


def _informations(reduction: Reduction, solution: Solution, root: FloatArray) -> FloatArray:
    """(s, f, f): rootᵀ A_s root of every stretch."""
    f = root.shape[1]
    found = np.zeros((reduction.n_stretches, f, f))
    for equation, sigma in zip(reduction.equations, solution.noise, strict=True):
        if not len(equation.counts):
            continue
        rows = equation.factors[:, :, :-1] @ (root[equation.columns] / sigma)
        found += rows.transpose(0, 2, 1) @ rows
    return found


def _without(informations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(1 - A_s)⁻¹ (s, f, f) of every stretch, and Σ v vᵀ (f, f) of the directions v that one of them alone tells of."""
    s, f, _ = informations.shape
    away, alone = np.zeros((s, f, f)), np.zeros((f, f))
    many = np.sqrt((informations**2).sum(axis=(1, 2))) > _ALONE
    away[~many] = np.linalg.inv(np.eye(f) - informations[~many])
    values, vectors = np.linalg.eigh(informations[many])
    lost = values > _ALONE
    kept = np.where(lost, 0.0, 1.0 / (1.0 - np.minimum(values, _ALONE)))
    away[many] = (vectors * kept[:, None, :]) @ vectors.transpose(0, 2, 1)
    gone = (vectors * lost[:, None, :]) @ vectors.transpose(0, 2, 1)
    return away, alone + gone.sum(axis=0)


def without_leverage(informations: FloatArray) -> FloatArray:
    """(s, f, f): what the estimate's own part in the residuals of each stretch is made up for by, of A_s (s, f, f)."""
    return _without(informations)[0]


def _satterthwaite(informations: FloatArray, away: FloatArray, directions: FloatArray) -> FloatArray:
    """(c,): degrees of freedom of the variance along directions (c, f), for independent residuals of size one.

    With u_s = (1 - A_s)⁻¹ l the steps lᵀd_s have the covariance Ω = δ u_sᵀA_s u_s - u_sᵀA_s A_t u_t: (tr Ω)² / tr Ω².
    """
    u = away @ directions.T
    v = informations @ u
    own = np.einsum("sik,sik->sk", u, v)
    size = np.einsum("sik,sik->sk", v, v)
    trace = (own - size).sum(axis=0)
    stacked = v.transpose(2, 0, 1)
    overlap = stacked @ stacked.transpose(0, 2, 1)
    squares = (own**2 - 2.0 * own * size).sum(axis=0) + (overlap**2).sum(axis=(1, 2))
    return np.asarray(trace**2 / np.maximum(squares, np.finfo(float).tiny))
