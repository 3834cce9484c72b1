"""By how much the rows of correlated residuals overstate the information in them."""

from __future__ import annotations

import numpy as np

from dynident.estimation.factors import EquationFactors, FloatArray, triangular

_FEWEST_STRETCHES = 5


def correlation_factor(equation: EquationFactors, values: FloatArray) -> float:
    """By how much the rows of one equation overstate the information in them (at least 1).

    With g_s = W_sᵀρ_s the score of stretch s and A = WᵀW: Σ g_sᵀ A⁻¹ g_s over what it would be for independent
    residuals of the same size, σ² (p - Σ tr((A⁻¹A_s)²)); the second term is what the fit itself takes away.
    """
    k = len(equation.columns)
    w = equation.factors[:, :, :k]
    rests = equation.factors[:, :, k] - w @ values[equation.columns]
    return overstatement(w, rests, float(equation.counts.sum()))


def overstatement(w: FloatArray, rests: FloatArray, rows: float) -> float:
    """The same for columns (s, m, p) and residuals (s, m) of every stretch, which stand for so many rows together."""
    n_stretches, _, k = w.shape
    if n_stretches < _FEWEST_STRETCHES or k == 0 or rows <= k:
        return 1.0
    # Columns that this equation hardly sees would make A singular: keep the directions it does see.
    _, singular, vt = np.linalg.svd(triangular(w.reshape(-1, k)), full_matrices=False)
    seen = singular > 1e-9 * singular[0] if singular[0] > 0 else np.zeros(len(singular), dtype=bool)
    if not seen.any():
        return 1.0
    whiten = vt[seen].T / singular[seen]
    projected = w @ whiten
    scores = np.einsum("sij,si->sj", projected, rests)
    grams = np.einsum("sij,sik->sjk", projected, projected)
    variance = float(np.sum(rests * rests)) / max(rows - seen.sum(), 1.0)
    expected = variance * (float(seen.sum()) - float(np.sum(grams * grams)))
    if expected <= 0 or variance == 0:
        return 1.0
    return float(max(1.0, np.sum(scores * scores) / expected))
