"""Condition number, D-, A- and E-optimality of W (§12.3.4.1) with gradients, and the baseline of random motions.

Each smooth criterion is a function of the eigenvalues of M = WᵀW / N (N samples), so that neither the number of samples
nor the sampling rate changes its value. Extreme singular values are not differentiable where they cross: the Schatten
p-norm, p = 8, replaces them during optimisation, and the true value is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri

from dynident.array_types import FloatArray
from dynident.excitation.criteria.criterion_choice import CriterionChoice, check_criterion
from dynident.excitation.criteria.parameter_variances import ParameterSelection, build_variance_criterion, sum_variances

Criterion = Callable[[FloatArray], tuple[float, FloatArray]]
"""Value and ∂/∂W (r, b) of a criterion at W (r, b), whose rows are divided by √N; the smaller the better."""

_SCHATTEN = 8.0
# Eigenvalues below this share of the largest are rounding errors: W has lost rank.
_FLOOR = 1e-14
ENTRY_ROUNDING = 1e-12
"""Entries of W below this share of the largest are zeros."""
# M beyond this is inverted by its eigenvalues.
_ILL_CONDITIONED = 1e11


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """Eigenvalues (b,), ascending and above zero, and eigenvectors (b, b) of M."""

    values: FloatArray
    vectors: FloatArray

    @classmethod
    def from_rows(cls, w: FloatArray) -> _Spectrum:
        values, vectors = np.linalg.eigh(w.T @ w)
        return cls(np.maximum(values, _FLOOR * values[-1] + np.finfo(float).tiny), vectors)

    def compute_gradient(self, w: FloatArray, slope: FloatArray) -> FloatArray:
        """Return ∂/∂W of a function of the eigenvalues with the derivatives `slope` (b,)."""
        # The derivative of an eigenvalue by M is v vᵀ, and M = WᵀW gives the factor 2 W.
        gradient: FloatArray = 2.0 * (w @ ((self.vectors * slope) @ self.vectors.T))
        return gradient

    def compute_log_norm(self, exponent: float) -> tuple[float, FloatArray]:
        """Return (1/|p|) log Σ λ^p and its slope: the smooth log λmax for p > 0, the smooth -log λmin for p < 0."""
        powers = exponent * np.log(self.values)
        # Subtract the largest power before the exponential, which would overflow otherwise.
        top = powers.max()
        weights = np.exp(powers - top)
        total = weights.sum()
        size = abs(exponent)
        return float(top + np.log(total)) / size, np.sign(exponent) * weights / total / self.values


def condition_number(w: FloatArray) -> tuple[float, FloatArray]:
    """Return the logarithm of the smooth condition number, ½ log(‖M‖p ‖M⁻¹‖p), [12.12], and its gradient.

    It comes from powers of M and M⁻¹, which take a fraction of the time of the eigenvalues; from these where M is
    nearly singular.
    """
    m = w.T @ w
    inverse = _invert(m)
    if inverse is None:
        return _compute_spectral_condition(w)
    large, slope_large = _compute_schatten_norm(m)
    small, slope_small = _compute_schatten_norm(inverse)
    # ∂ of a function of M⁻¹: -M⁻¹ (…) M⁻¹.
    slope = 0.5 * (slope_large - inverse @ slope_small @ inverse)
    return 0.5 * (large + small), 2.0 * (w @ slope)


def _compute_schatten_norm(m: FloatArray) -> tuple[float, FloatArray]:
    """Return log (tr M⁸)^(1/8) of a positive definite M and its derivative M⁷ / tr M⁸: the Schatten norm for p = 8."""
    size = float(np.trace(m))
    # Divided by its trace, powers of M neither overflow nor underflow. Three products give the eighth power.
    first = m / size
    second = first @ first
    fourth = second @ second
    total = float(np.sum(fourth * fourth))
    return np.log(size) + np.log(total) / _SCHATTEN, fourth @ (second @ first) / (total * size)


def _invert(m: FloatArray) -> FloatArray | None:
    """Return M⁻¹ by Cholesky; None where M is so near to singular that its small eigenvalues are lost in it."""
    factor, failed = dpotrf(m, lower=1)
    if failed:
        return None
    # LAPACK fills the lower triangle alone.
    lower, failed = dpotri(factor, lower=1)
    inverse: FloatArray = np.tril(lower) + np.tril(lower, -1).T
    ill = failed or not np.trace(m) * np.trace(inverse) < _ILL_CONDITIONED
    return None if ill else inverse


def _compute_spectral_condition(w: FloatArray) -> tuple[float, FloatArray]:
    spectrum = _Spectrum.from_rows(w)
    large, slope_large = spectrum.compute_log_norm(_SCHATTEN)
    small, slope_small = spectrum.compute_log_norm(-_SCHATTEN)
    return 0.5 * (large + small), spectrum.compute_gradient(w, 0.5 * (slope_large + slope_small))


def d_optimal(w: FloatArray) -> tuple[float, FloatArray]:
    """Return -log det M / b, which is the volume of the parameters' confidence ellipsoid, and its gradient."""
    spectrum = _Spectrum.from_rows(w)
    b = w.shape[1]
    return -float(np.log(spectrum.values).sum()) / b, spectrum.compute_gradient(w, -1.0 / spectrum.values / b)


def a_optimal(w: FloatArray) -> tuple[float, FloatArray]:
    """Return log trace M⁻¹, which is the sum of the parameters' variances, and its gradient."""
    spectrum = _Spectrum.from_rows(w)
    value, slope = spectrum.compute_log_norm(-1.0)
    return value, spectrum.compute_gradient(w, slope)


def e_optimal(w: FloatArray) -> tuple[float, FloatArray]:
    """Return the smooth -log σmin, which is the worst direction among the parameters, and its gradient."""
    spectrum = _Spectrum.from_rows(w)
    value, slope = spectrum.compute_log_norm(-_SCHATTEN)
    return 0.5 * value, spectrum.compute_gradient(w, 0.5 * slope)


def condition_plus_inverse_sigma(weight: float) -> Criterion:
    """Return the criterion log of [12.14], cond(W) + k2 / σmin."""

    def criterion(w: FloatArray) -> tuple[float, FloatArray]:
        spectrum = _Spectrum.from_rows(w)
        large, slope_large = spectrum.compute_log_norm(_SCHATTEN)
        small, slope_small = spectrum.compute_log_norm(-_SCHATTEN)
        condition, inverse = np.exp(0.5 * (large + small)), weight * np.exp(0.5 * small)
        # Derivative of the logarithm of a sum: both terms hold 1 / σmin, and the first alone σmax.
        share = condition / (condition + inverse)
        slope = 0.5 * (share * slope_large + slope_small)
        return float(np.log(condition + inverse)), spectrum.compute_gradient(w, slope)

    return criterion


def build_equilibrated_criterion(weight: float) -> Criterion:
    """Return the criterion log of [12.13], cond(W) + k1 max|Wij| / min|Wij| over the entries that are not zero.

    Both extremes are p-norms of the entries, as those of the singular values are.
    """

    def criterion(w: FloatArray) -> tuple[float, FloatArray]:
        log_condition, gradient = condition_number(w)
        # The structure of W has zeros that no motion changes; [12.13] means the smallest of the other entries.
        present = find_nonzero_entries(w)
        entries = _Spectrum(np.square(w[present]), np.empty((0, 0)))
        large, slope_large = entries.compute_log_norm(_SCHATTEN)
        small, slope_small = entries.compute_log_norm(-_SCHATTEN)
        condition, ratio = np.exp(log_condition), weight * np.exp(0.5 * (large + small))
        total = condition + ratio
        of_ratio = np.zeros_like(w)
        of_ratio[present] = w[present] * (slope_large + slope_small)  # ½ · 2 w · slope
        return float(np.log(total)), (condition / total) * gradient + (ratio / total) * of_ratio

    return criterion


def find_nonzero_entries(w: FloatArray) -> NDArray[np.bool_]:
    """Return which entries (r, b) count for [12.13], min|Wij| ≠ 0: those above the rounding errors of the largest."""
    present: NDArray[np.bool_] = np.abs(w) > ENTRY_ROUNDING * np.abs(w).max()
    return present


def build_weighted_criterion(a_priori: FloatArray) -> Criterion:
    """Return the criterion log of the smooth cond(W diag(Z)), [12.15]; a_priori (b,) is |Z|."""

    def criterion(w: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = condition_number(w * a_priori)
        return value, gradient * a_priori

    return criterion


def build_smooth_criterion(
    choice: CriterionChoice, a_priori: FloatArray, deciding: ParameterSelection | None = None
) -> Criterion:
    """Return the smooth criterion of a choice.

    Parameters
    ----------
    choice : CriterionChoice
        The criterion.
    a_priori : (b,)
        |Z| of [12.15].
    deciding : ParameterSelection, optional
        Parameters that "parameters" and "separation" are about; all where left out.

    Returns
    -------
    callable
        Value and ∂/∂W (r, b) at W (r, b).
    """
    check_criterion(choice)
    scope = deciding or ParameterSelection.select_all(len(a_priori))
    # All of them are logarithms: their differences are relative, and no criterion needs a scale of its own.
    criteria: Mapping[str, Criterion] = {
        "condition_number": condition_number,
        "d_optimal": d_optimal,
        "a_optimal": a_optimal,
        "e_optimal": e_optimal,
        "equilibrated": build_equilibrated_criterion(choice.weight),
        "condition_plus_inverse_sigma": condition_plus_inverse_sigma(choice.weight),
        "weighted": build_weighted_criterion(a_priori),
        "parameters": build_variance_criterion(scope, a_priori),
        "separation": build_variance_criterion(scope, a_priori),
        "prediction": build_variance_criterion(scope, a_priori),
    }
    return criteria[choice.name]


@dataclass(frozen=True)
class Baseline:
    """Values of random motions, which the result of a design is compared with.

    Parameters
    ----------
    count : int
        Number of random motions.
    best : CriterionValues
        Values of the best of them by the chosen criterion.
    median_condition_number : float
        Median of their condition numbers [12.12].
    """

    count: int
    best: CriterionValues
    median_condition_number: float


def compute_baseline(values: Sequence[CriterionValues]) -> Baseline:
    """Return the baseline from the values of random motions.

    Parameters
    ----------
    values : sequence of CriterionValues
        Values of each random motion.

    Returns
    -------
    Baseline
        The best of them, and their median.
    """
    best = min(values, key=lambda motion_values: motion_values.criterion)
    return Baseline(len(values), best, float(np.median([motion_values.condition_number for motion_values in values])))


@dataclass(frozen=True)
class CriterionValues:
    """Values of a motion by all criteria; singular values are those of W / √N.

    Parameters
    ----------
    condition_number : float
        [12.12], infinite where W does not have full rank.
    criterion : float
        The chosen criterion's value as the chapter writes it.
    smallest_singular_value, largest_singular_value : float
        Singular values of W / √N, where W has N samples.
    log_determinant, trace_of_inverse : float
        Logarithm of det M and trace of M⁻¹, with M = WᵀW / N.
    """

    condition_number: float
    criterion: float
    smallest_singular_value: float
    largest_singular_value: float
    log_determinant: float
    trace_of_inverse: float


def compute_true_values(
    choice: CriterionChoice,
    w: FloatArray,
    n_samples: int,
    a_priori: FloatArray,
    deciding: ParameterSelection | None = None,
) -> CriterionValues:
    """Return the values of W without smoothing, by singular values.

    Parameters
    ----------
    choice : CriterionChoice
        The criterion.
    w : (r, b)
        Rows of W.
    n_samples : int
        Number of samples N.
    a_priori : (b,)
        Magnitudes |Z| of the parameters.
    deciding : ParameterSelection or None
        Parameters that the criterion is about; all where left out.

    Returns
    -------
    CriterionValues
        Values by all criteria, infinite where W does not have full rank.
    """
    # Divided by √N, so that the values do not depend on the number of samples.
    scaled = w / np.sqrt(n_samples)
    sigma = np.linalg.svd(scaled, compute_uv=False)
    condition = _divide_or_infinite(float(sigma[0]), float(sigma[-1]))
    # Without full rank the smallest singular value is rounding; its inverse would be a large number without meaning.
    full = np.isfinite(condition)
    inverse_squares = float(np.sum(sigma**-2)) if full else np.inf
    scope = deciding or ParameterSelection.select_all(w.shape[1])
    log_determinant = float(2 * np.sum(np.log(sigma))) if full else -np.inf
    return CriterionValues(
        condition_number=condition,
        criterion=_compute_chosen_value(choice, scaled, sigma, a_priori, scope, log_determinant, inverse_squares),
        smallest_singular_value=float(sigma[-1]),
        largest_singular_value=float(sigma[0]),
        log_determinant=log_determinant,
        trace_of_inverse=inverse_squares,
    )


def _compute_chosen_value(
    choice: CriterionChoice,
    w: FloatArray,
    sigma: FloatArray,
    a_priori: FloatArray,
    deciding: ParameterSelection,
    log_determinant: float,
    inverse_squares: float,
) -> float:
    """Return the value of the chosen criterion as the chapter writes it."""
    condition = _divide_or_infinite(float(sigma[0]), float(sigma[-1]))
    if choice.name == "equilibrated":
        sizes = np.abs(w[find_nonzero_entries(w)])
        return condition + choice.weight * float(sizes.max() / sizes.min())
    if choice.name == "condition_plus_inverse_sigma":
        return condition + (choice.weight / float(sigma[-1]) if np.isfinite(condition) else np.inf)
    if choice.name == "weighted":
        of_weighted = np.linalg.svd(w * a_priori, compute_uv=False)
        return _divide_or_infinite(float(of_weighted[0]), float(of_weighted[-1]))
    if choice.name in ("parameters", "separation", "prediction"):
        return sum_variances(deciding, a_priori, w)
    if choice.name == "d_optimal":
        return -log_determinant
    if choice.name == "a_optimal":
        return inverse_squares
    if choice.name == "e_optimal":
        return 1.0 / float(sigma[-1]) if np.isfinite(condition) else np.inf
    return condition


def _divide_or_infinite(largest: float, smallest: float) -> float:
    """Return the first over the second, infinite where the second is rounding."""
    # Singular values have errors of about machine precision times the largest one.
    return largest / smallest if smallest > 1e-12 * largest else np.inf
