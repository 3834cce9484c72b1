"""Errors of given parameters on reduced data, by group of rows; Student's t; how large residuals become over time.

The rows of an equation form groups (`row_groups`). The residual of a row in the fit is its error. The error of an
interval row is the distance of the measured value to its interval. Every row that was counted by itself has an interval
row as well, and counts once in the errors on all rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import KnownNames
from dynident.estimation.triangular_factors import Reduction
from dynident.number_format import format_percent


@dataclass(frozen=True, eq=False)
class Errors(KnownNames):
    """How well parameters explain a data set, equation by equation.

    Parameters
    ----------
    squares, measured : (n,)
        Sums of squares of the residual and of Y.
    counts : (n,)
        Numbers of rows.
    """

    squares: FloatArray
    measured: FloatArray
    counts: FloatArray

    def __repr__(self) -> str:
        return f"Errors({len(self.counts)} equations: relative error {format_percent(self.relative_total)})"

    @property
    def rms(self) -> FloatArray:
        """Root mean square of the residual (n,), N m or N."""
        return np.sqrt(self.squares / np.maximum(self.counts, 1))

    @property
    def relative(self) -> FloatArray:
        """Relative error ||y - ŷ|| / ||y|| (n,); 1 where nothing was measured and something predicted."""
        safe = np.where(self.measured > 0, self.measured, 1.0)
        return np.where(self.measured > 0, np.sqrt(self.squares / safe), np.where(self.squares > 0, 1.0, 0.0))

    @property
    def relative_total(self) -> float:
        """Relative error ||Y - Ŷ|| / ||Y|| over all equations."""
        total = float(self.measured.sum())
        return float(np.sqrt(self.squares.sum() / total)) if total > 0 else 0.0

    @property
    def rms_total(self) -> float:
        """Root mean square of the residual over all equations and samples."""
        return float(np.sqrt(self.squares.sum() / max(float(self.counts.sum()), 1.0)))

    def compute_ratio_to(self, fit: Errors) -> float:
        """Return these errors over others, those of held-out data over those of the fit, each equation in units of it.

        NaN where no equation has both.
        """
        known = (self.counts > 0) & (fit.counts > 0) & (fit.rms > 0)
        return float(np.sqrt(np.mean((self.rms[known] / fit.rms[known]) ** 2))) if known.any() else math.nan

    def select(self, equations: BoolArray) -> Errors:
        """Return the errors of only these of the n equations (n,)."""
        return Errors(self.squares[equations], self.measured[equations], self.counts[equations])

    def __add__(self, other: Errors) -> Errors:
        """Return the errors on both sets of rows together."""
        return Errors(self.squares + other.squares, self.measured + other.measured, self.counts + other.counts)


@dataclass(frozen=True, eq=False)
class ErrorsByGroup:
    """Errors on the groups of rows of every equation.

    Parameters
    ----------
    plain : Errors
        Rows of no group. An equation without separate rows counts all its rows as plain.
    weighted : Errors
        Rows with a weight of their own, each counting alike here.
    counted : Errors
        Rows in the fit that are counted by themselves.
    interval : Errors
        Interval rows: the distance of the measured value to the interval.
    """

    plain: Errors
    weighted: Errors
    counted: Errors
    interval: Errors

    @property
    def all_rows(self) -> Errors:
        """Errors on all rows, each once: rows that are counted by themselves have interval rows as well."""
        return self.plain + self.weighted + self.interval


def compute_errors_by_group(reduction: Reduction, values: FloatArray) -> ErrorsByGroup:
    """Compute the residual of parameters on the rows of a data set, by groups of rows.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors.
    values : (c,)
        Parameters χ.

    Returns
    -------
    ErrorsByGroup
        Sums of squares and numbers of rows of every equation.
    """
    fitted = compute_fitted_errors(reduction, values)
    weighted, counted, interval = (np.zeros((3, len(reduction.equations))) for _ in range(3))
    for k, equation in enumerate(reduction.equations):
        separate_rows, own = equation.separate_rows, values[equation.columns]
        if separate_rows is None:
            continue
        groups = (
            (weighted, equation.group_rows),
            (counted, separate_rows.counted),
            (interval, separate_rows.interval),
        )
        for sums, rows in groups:
            if rows is not None:
                sums[:, k] = rows.sum_squares(own), rows.measured_squares, rows.count
    # Differences of sums of squares may fall below zero by rounding.
    plain = np.maximum(np.array([fitted.squares, fitted.measured, fitted.counts]) - weighted - counted, 0.0)
    return ErrorsByGroup(Errors(*plain), Errors(*weighted), Errors(*counted), Errors(*interval))


def compute_errors(reduction: Reduction, values: FloatArray) -> Errors:
    """Compute the residual of parameters on all rows of a data set, of interval rows the distance to the interval.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors.
    values : (c,)
        Parameters χ.

    Returns
    -------
    Errors
        Sums of squares and numbers of rows of every equation, as in `ErrorsByGroup.all_rows`.
    """
    return compute_errors_by_group(reduction, values).all_rows


def compute_fitted_errors(reduction: Reduction, values: FloatArray) -> Errors:
    """Return the residual on all rows that take part in the fit, each counting alike.

    Parameters
    ----------
    reduction : Reduction
        The equations, one a joint or of another equation type.
    values : (c,)
        Parameters χ.

    Returns
    -------
    Errors
        Squared residuals, squared measured values and numbers of rows by equation.
    """
    squares, measured = compute_weighted_squares(reduction, values), []
    for k, equation in enumerate(reduction.equations):
        own = float(equation.whole_factor[:, -1] @ equation.whole_factor[:, -1])
        if equation.weighted_rows is not None:
            # The factor holds the weighted rows with their weight; add what is missing to a weight of one.
            lacks = 1.0 - equation.weighted_rows.weight
            squares[k] += lacks * equation.weighted_rows.sum_squares(values[equation.columns])
            own += lacks * equation.weighted_rows.measured_squares
        measured.append(own)
    return Errors(squares, np.array(measured), reduction.row_counts)


def compute_weighted_squares(reduction: Reduction, values: FloatArray) -> FloatArray:
    """Return the squared residual (n,) of parameters χ (c,) in every equation, its rows as they are weighted there."""
    rests = (e.whole_factor[:, -1] - e.whole_factor[:, :-1] @ values[e.columns] for e in reduction.equations)
    return np.array([float(rest @ rest) for rest in rests])


def compute_residual_noise(reduction: Reduction, values: FloatArray) -> FloatArray:
    """Return the standard deviation (n,) of every equation's residual, [12.7], parameters shared out over the rows.

    Rows count as they are weighted within their equation; `compute_row_noise` has each count alike.
    """
    return compute_deviation(reduction, compute_weighted_squares(reduction, values))


def compute_deviation(reduction: Reduction, squares: FloatArray) -> FloatArray:
    """Return the standard deviation (n,) of rows whose squared residuals sum up to `squares` (n,), [12.7]."""
    # Equations share the parameters: each loses degrees of freedom by its rows; below the limit variances diverge.
    share = max(1.0 - reduction.n_columns / max(reduction.n_rows, 1), 0.1)
    return np.asarray(np.sqrt(squares / np.maximum(reduction.row_counts * share, 1)))


def compute_relative_change(reduction: Reduction, change: FloatArray) -> float:
    """Return ||W Δχ|| / ||Y||: the effect of a change of the parameters, relative to what was measured.

    Parameters
    ----------
    reduction, change : Reduction, (c,)
        The equations as triangular factors, and the change Δχ of the parameters.

    Returns
    -------
    float
        A fraction; 0 where nothing was measured.
    """
    squares = measured = 0.0
    for equation in reduction.equally_weighted.equations:
        k = len(equation.columns)
        moved = equation.whole_factor[:, :k] @ change[equation.columns]
        squares += float(moved @ moved)
        measured += float(equation.whole_factor[:, k] @ equation.whole_factor[:, k])
    return float(np.sqrt(squares / measured)) if measured > 0 else 0.0


def compute_t(gains: FloatArray) -> float:
    """Return t of the gains (s,) in blocks of time; 0 where all gain the same, or there is one alone.

    Parameters
    ----------
    gains : (s,)
        Drop of the squared error in every block.

    Returns
    -------
    float
        The mean gain over its standard error.
    """
    # Blocks, not samples: residuals are correlated within a block.
    spread = float(gains.std(ddof=1)) if len(gains) > 1 else 0.0
    return float(gains.mean() / (spread / np.sqrt(len(gains)))) if spread > 0 else 0.0


def compute_evenness(gains: FloatArray) -> FloatArray:
    """Return t of the mean over blocks of time of the signed roots of gains.

    Of the roots, since a gain is a square: else one block that shows an effect well hides that the others do, too.

    Parameters
    ----------
    gains : (c, s)
        Drop of the squared error in every block, of c models or effects.

    Returns
    -------
    (c,) array
        0 where all blocks gain the same.
    """
    values = compute_signed_roots(gains)
    spread = values.std(axis=-1, ddof=1) / np.sqrt(values.shape[-1])
    return np.asarray(np.divide(values.mean(axis=-1), spread, out=np.zeros_like(spread), where=spread > 0))


def compute_signed_roots(gains: FloatArray) -> FloatArray:
    """Return the roots of the sizes of gains, of any shape, with their signs."""
    return np.asarray(np.sign(gains) * np.sqrt(np.abs(gains)))


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
