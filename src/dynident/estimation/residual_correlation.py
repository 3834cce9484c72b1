"""Correlated residuals: by what factor they overstate the number of rows, and how large they become in a long time.

Covariances are in `parameter_covariance`, autocorrelation figures in diagnosis/comparison/.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation.qr_decomposition import WhitenedColumns, compute_r_factor, whiten_columns
from dynident.estimation.triangular_factors import EquationFactors, Reduction

# With fewer blocks of time chance decides how large the scores are.
_FEWEST_BLOCKS = 5


def compute_correlation_factor(equation: EquationFactors, values: FloatArray, fit: FloatArray | None = None) -> float:
    """Return by how much the rows of one equation overstate the information in them, at least 1.

    Parameters
    ----------
    equation : EquationFactors
        The rows of one equation, by blocks of time.
    values : (c,)
        Parameters χ at which the residuals are taken.
    fit : (p, p), optional
        Covariance M of this equation's parameters in the fit that the residuals are of, over the variance σ² of its
        rows; by default A⁻¹, that of a fit to these rows alone.

    Returns
    -------
    float
        Number of rows over number of independent samples; 1 where there are too few blocks or rows to tell.

    Notes
    -----
    With g_s = W_sᵀρ_s the score of block s and A = WᵀW: Σ g_sᵀ A⁻¹ g_s over what it would be for independent
    residuals of the same size, σ² (p - Σ tr(A⁻¹A_s M A_s)); the second term is what the fit itself removes. Joints
    share most of their parameters, so that a fit to all joints removes much less of each than one to its rows alone.
    """
    # Residuals of the factors, not of the rows: Wᵀρ and ρᵀρ of a block are the same for both.
    rests = equation.factors[:, :, -1] - equation.factors[:, :, :-1] @ values[equation.columns]
    rows = float(equation.counts.sum())
    if not _is_determined(equation.factors[:, :, :-1], rows):
        return 1.0
    columns = equation.whitened_columns
    share = None if fit is None or columns is None else _whiten_fit(equation, columns, fit)
    return _compute_overstatement_of_whitened(columns, rests, rows, share)


def compute_correlation_factors(
    reduction: Reduction, values: FloatArray, fits: Sequence[FloatArray] | None = None
) -> FloatArray:
    """Return by how much the rows of every equation overstate the information in them.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.
    values : (c,)
        Parameters χ at which the residuals are taken.
    fits : n of (p_j, p_j), optional
        Covariances of the parameters as `compute_correlation_factor` takes them.

    Returns
    -------
    (n,) array
        Correlation factors, at least 1.
    """
    each = [None] * len(reduction.equations) if fits is None else fits
    return np.array(
        [compute_correlation_factor(e, values, fit) for e, fit in zip(reduction.equations, each, strict=True)]
    )


def count_effective_rows(reduction: Reduction, values: FloatArray) -> FloatArray:
    """Return how many independent samples the rows of every equation are worth.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.
    values : (c,)
        Parameters χ at which the residuals are taken.

    Returns
    -------
    (n,) array
        Effective numbers of rows, at most the numbers of rows.
    """
    return reduction.row_counts / compute_correlation_factors(reduction, values)


def count_correlation_freedom(equation: EquationFactors, fit: FloatArray | None = None) -> float:
    """Return the degrees of freedom with which an equation's correlation factor is known, at least 1.

    Parameters
    ----------
    equation : EquationFactors
        The rows of one equation, by blocks of time.
    fit : (p, p), optional
        Covariance of its parameters as `compute_correlation_factor` takes it.

    Returns
    -------
    float
        (tr Ω)² / tr Ω² (Satterthwaite), Ω the form in the residuals that the sum of the scores' squares is; 1 where
        there are too few blocks or rows to tell.
    """
    columns = equation.whitened_columns
    if columns is None or not _is_determined(equation.factors[:, :, :-1], float(equation.counts.sum())):
        return 1.0
    grams = columns.rows.transpose(0, 2, 1) @ columns.rows
    squares = grams @ grams
    share = np.eye(columns.count) if fit is None else _whiten_fit(equation, columns, fit)
    # The residuals are those of a fit, which takes its own part out of every block's score: of blocks s and t together
    # these are δ G_s - G_s M G_t.
    taken = squares @ share
    trace = columns.count - float(np.trace(taken.sum(axis=0)))
    overlap = taken.sum(axis=0)
    cubes, crossed = float(np.sum(taken * grams)), float(np.sum(overlap * overlap.T))
    return max(1.0, trace**2 / max(columns.spread - 2.0 * cubes + crossed, np.finfo(float).tiny))


def _whiten_fit(equation: EquationFactors, columns: WhitenedColumns, fit: FloatArray) -> FloatArray:
    """Return the covariance (p, p) of a fit in coordinates in which the columns are whitened."""
    coordinates = np.einsum("smi,smj->ij", columns.rows, equation.factors[:, :, :-1], optimize=True)
    return np.asarray(coordinates @ fit @ coordinates.T)


def compute_overstatement(w: FloatArray, rests: FloatArray, rows: float) -> float:
    """Return the correlation factor of columns and residuals, as `compute_correlation_factor` does.

    Parameters
    ----------
    w : (s, m, p)
        Columns of s blocks: of W, or of the instruments.
    rests : (s, m)
        Residuals in the same rows.
    rows : float
        Number of rows that they stand for together.

    Returns
    -------
    float
        At least 1.
    """
    if not _is_determined(w, rows):
        return 1.0
    return _compute_overstatement_of_whitened(
        whiten_columns(w, compute_r_factor(w.reshape(-1, w.shape[2]))), rests, rows
    )


def _is_determined(w: FloatArray, rows: float) -> bool:
    n_blocks, _, k = w.shape
    return bool(n_blocks >= _FEWEST_BLOCKS and k > 0 and rows > k)


def _compute_overstatement_of_whitened(
    columns: WhitenedColumns | None, rests: FloatArray, rows: float, share: FloatArray | None = None
) -> float:
    """Return the correlation factor; `share` is the covariance of the fit in whitened coordinates, if not one."""
    if columns is None:
        return 1.0
    fitted, removed = float(columns.count), columns.spread
    if share is not None:
        grams = columns.rows.transpose(0, 2, 1) @ columns.rows
        fitted, removed = float(np.trace(share)), float(np.sum((grams @ share) * grams))
    # With whitened columns A is one, so that the score's weighted square is a plain sum of squares.
    scores = (rests[:, None, :] @ columns.rows)[:, 0]
    variance = float(np.sum(rests * rests)) / max(rows - fitted, 1.0)
    expected = variance * (columns.count - removed)
    if expected <= 0 and share is not None:
        # A fit that leaves nothing of the scores to judge by: its own part alone is then taken out.
        return _compute_overstatement_of_whitened(columns, rests, rows)
    if expected <= 0 or variance == 0:
        return 1.0
    # Below one would mean that rows hold more than their own number of samples: it is chance, and is not used.
    return float(max(1.0, np.sum(scores * scores) / expected))


BLOCK = 1.0
"""Seconds of a block, whose largest value counts once, and of an alarm: neighbouring samples depend on each other."""
# Share of the blocks whose largest values count as the tail, and fewest of them.
_TAIL, _FEWEST_PEAKS = 0.1, 5


def compute_block_maxima(values: FloatArray, period: float) -> FloatArray:
    """Return the largest value of each whole second.

    Parameters
    ----------
    values : (m,)
        Values that follow each other.
    period : float
        Time between two of them in s.
    """
    length = max(1, round(BLOCK / period))
    count = len(values) // length
    return np.asarray(values[: count * length].reshape(count, length).max(axis=1, initial=0.0))


def compute_threshold(maxima: Sequence[FloatArray], share: float) -> float:
    """Return the value that a further block's largest value exceeds with a given probability.

    The excesses of the largest values over a level have an exponential tail. What their number leaves open about its
    mean counts: of k independent excesses with the mean m, a further one is above x with the probability
    (1 + x / (k m))⁻ᵏ (the predictive distribution; Lawless 1973). So few values make a higher threshold, by as much as
    the stated rate needs to hold in the mean. A tail with an end that the data tell, as of bounded friction, was tried:
    at five alarms an hour there were twenty times as many.

    Parameters
    ----------
    maxima : sequence of (m_i,)
        Largest values of blocks of time, which follow each other.
    share : float
        The probability.
    """
    values = np.sort(np.concatenate(maxima))[::-1]
    count = min(max(_FEWEST_PEAKS, round(_TAIL * len(values))), len(values) - 1)
    ratio = count / len(values) / share
    if ratio <= 1.0:
        return float(np.quantile(values, 1.0 - min(share, 1.0)))
    level, mean = float(values[count]), float(np.mean(values[:count] - values[count]))
    independent = max(count * _count_independent_blocks(maxima) / len(values), float(_FEWEST_PEAKS))
    return level + independent * mean * float(ratio ** (1.0 / independent) - 1.0)


def _count_independent_blocks(maxima: Sequence[FloatArray]) -> float:
    """Return how many independent blocks these are worth: m / (1 + 2 Σ ρ²), over the lags that are beyond chance.

    All lags count up to half the longest interval: a motion that is repeated again and again says little new.
    """
    count = sum(map(len, maxima))
    mean, lags = float(np.mean(np.concatenate(maxima))), max(map(len, maxima)) // 2
    sums = np.zeros(lags + 1)
    for part in maxima:
        own = np.correlate(part - mean, part - mean, "full")[len(part) - 1 :][: lags + 1]
        sums[: len(own)] += own
    if not sums[0] > 0:
        return 1.0
    squares = (sums[1:] / sums[0]) ** 2
    return count / (1.0 + 2.0 * float(squares[squares > 4.0 / count].sum()))
