"""Weight functions of robust regression, by Huber and Tukey, and a scale that ignores outliers.

Huber's function has one minimum whatever the first estimate, but a gross outlier still pulls with a constant force.
Tukey's bisquare rejects it entirely, but has local minima near a poor first estimate. So Huber's comes first and
the bisquare starts from where it ends (Yohai 1987; Maronna, Martin and Yohai 2006, chapter 5). With the usual constants
both lose a twentieth of the efficiency of least squares where residuals are normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray

# The usual constants, in standard deviations: an efficiency of 95 % where residuals are normal.
_HUBER, _BISQUARE = 1.345, 4.685
# Median absolute deviation of a normal distribution, in standard deviations.
_MEDIAN = 0.6744897501960817


@dataclass(frozen=True)
class Influence:
    """How a residual u, in units of its standard deviation, acts on the estimate.

    Parameters
    ----------
    weight, slope : callable
        w(u) = ψ(u) / u and ψ'(u), for arrays of any shape.
    """

    weight: Callable[[FloatArray], FloatArray]
    slope: Callable[[FloatArray], FloatArray]


def _huber_weight(u: FloatArray) -> FloatArray:
    return np.asarray(_HUBER / np.maximum(np.abs(u), _HUBER))


def _huber_slope(u: FloatArray) -> FloatArray:
    return np.asarray((np.abs(u) <= _HUBER).astype(np.float64))


def _bisquare_weight(u: FloatArray) -> FloatArray:
    inside = np.maximum(1.0 - (u / _BISQUARE) ** 2, 0.0)
    return np.asarray(inside**2)


def _bisquare_slope(u: FloatArray) -> FloatArray:
    square = (u / _BISQUARE) ** 2
    return np.asarray(np.where(square < 1.0, (1.0 - square) * (1.0 - 5.0 * square), 0.0))


HUBER = Influence(_huber_weight, _huber_slope)
BISQUARE = Influence(_bisquare_weight, _bisquare_slope)


def estimate_robust_scale(residuals: FloatArray) -> FloatArray:
    """Return the standard deviation about zero of residuals (m, n) per column, from their median size.

    A third of them may be outliers. NaN does not count; a column without any number has a scale of zero.
    """
    scale = np.zeros(residuals.shape[1])
    known = np.isfinite(residuals).any(axis=0)
    scale[known] = np.nanmedian(np.abs(residuals[:, known]), axis=0) / _MEDIAN
    return scale
