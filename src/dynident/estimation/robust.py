"""What a residual counts in robust regression: Huber's and Tukey's functions, and a scale that ignores outliers.

Huber's function has one minimum whatever the first estimate, but a gross outlier still pulls with a constant force.
Tukey's bisquare lets it go entirely, but has minima of its own beside a poor first estimate. So Huber's comes first and
the bisquare starts from where it ends (Yohai 1987; Maronna, Martin and Yohai 2006, chapter 5). With the usual constants
both lose a twentieth of the efficiency of least squares where residuals are normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray

_HUBER, _BISQUARE = 1.345, 4.685
# Median absolute deviation of a normal distribution, in standard deviations.
_MEDIAN = 0.6744897501960817


@dataclass(frozen=True)
class Influence:
    """How a residual u, in units of its standard deviation, acts on the estimate.

    `weight` is w(u) = ψ(u) / u, `slope` ψ'(u), for arrays of any shape.
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


def robust_scale(residuals: FloatArray) -> FloatArray:
    """(n,): standard deviation of residuals (m, n) about zero, from their median size: a third may be outliers.

    What is not a number does not count; of an equation without any it is zero.
    """
    scale = np.zeros(residuals.shape[1])
    known = np.isfinite(residuals).any(axis=0)
    scale[known] = np.nanmedian(np.abs(residuals[:, known]), axis=0) / _MEDIAN
    return scale
