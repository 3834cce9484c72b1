"""Condition number, D-, A- and E-optimality of W (§12.3.4.1) with gradients, and the baseline of random motions.

Each smooth criterion is a function of the eigenvalues of M = WᵀW / N (N samples), so that neither the number of samples
nor the sampling rate changes its value. Extreme singular values are not differentiable where they cross: the Schatten
p-norm, p = 8, replaces them during optimisation, and the true value is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import EllipsisType

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.excitation.criteria.criterion_choice import CriterionChoice, check_criterion
from dynident.excitation.criteria.parameter_variances import ParameterSelection, build_variance_criterion, sum_variances

Criterion = Callable[[FloatArray], tuple[float, FloatArray]]
"""Value and ∂/∂W (r, b) of a criterion at W (r, b), whose rows are divided by √N; the smaller the better."""

_OfInformation = Callable[[FloatArray], tuple[float, FloatArray]]
"""Value and symmetric ∂/∂M (b, b) of a criterion at M (b, b)."""

Blocks = Sequence[tuple[IndexArray, ...] | EllipsisType]
"""Places in M (b, b), as NumPy's indices, outside of which it is zero."""

_SCHATTEN = 8.0
# Eigenvalues below this share of the largest are rounding errors: W has lost rank.
_FLOOR = 1e-14
_DENSE = 0.25
"""Share of the products of all columns above which an arm's few joints are no quicker one by one."""
ENTRY_ROUNDING = 1e-12
"""Entries of W below this share of the largest are zeros."""
# M beyond this is inverted by its eigenvalues.
_ILL_CONDITIONED = 1e11


@dataclass(frozen=True, eq=False)
class RowStructure:
    """Entries of W that are zero in every motion: a joint's equation has columns of what it carries alone.

    With it M of a robot with many joints costs a fraction of what it costs without.

    Parameters
    ----------
    equations : tuple of (c,)
        Indices of the columns of each of the k equations of a sample.
    blocks : Blocks
        Places in M of the limbs, which have no equation in common; outside of them it is zero.
    """

    equations: tuple[IndexArray, ...]
    blocks: Blocks

    @classmethod
    def from_entries(cls, present: BoolArray) -> RowStructure:
        """Return the structure of entries (k, b) that are not zero in every motion."""
        count, limb = scipy.sparse.csgraph.connected_components(present.T.astype(float) @ present)
        limbs = [np.flatnonzero(limb == k) for k in range(count)]
        blocks = [np.ix_(columns, columns) for columns in limbs] if count > 1 else [...]
        return cls(tuple(np.flatnonzero(own) for own in present), tuple(blocks))

    @cached_property
    def _is_dense(self) -> bool:
        """Whether so few products are left out that one product of whole matrices takes less time."""
        n_columns = len(np.unique(np.concatenate(self.equations)))
        return sum(len(columns) ** 2 for columns in self.equations) > _DENSE * len(self.equations) * n_columns**2

    def compute_information(self, w: FloatArray) -> FloatArray:
        """Return M = WᵀW (b, b) of rows (m k, b)."""
        if self._is_dense:
            return w.T @ w
        m = np.zeros((w.shape[1], w.shape[1]))
        for j, columns in enumerate(self.equations):
            own = w[j :: len(self.equations), columns]
            m[columns[:, None], columns] += own.T @ own
        return m

    def multiply(self, w: FloatArray, slope: FloatArray) -> FloatArray:
        """Return W slope (m k, b) for a matrix (b, b), at the places where W has entries."""
        if self._is_dense:
            return w @ slope
        product = np.zeros_like(w)
        for j, columns in enumerate(self.equations):
            product[j :: len(self.equations), columns] = (
                w[j :: len(self.equations), columns] @ slope[columns[:, None], columns]
            )
        return product


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """Eigenvalues (b,), ascending and above zero, and eigenvectors (b, b) of M."""

    values: FloatArray
    vectors: FloatArray

    @classmethod
    def from_information(cls, m: FloatArray) -> _Spectrum:
        values, vectors = np.linalg.eigh(m)
        return cls(np.maximum(values, _FLOOR * values[-1] + np.finfo(float).tiny), vectors)

    def compute_slope(self, slope: FloatArray) -> FloatArray:
        """Return ∂/∂M (b, b) of a function of the eigenvalues with the derivatives `slope` (b,)."""
        # The derivative of an eigenvalue by M is v vᵀ.
        of_information: FloatArray = (self.vectors * slope) @ self.vectors.T
        return of_information

    def compute_log_norm(self, exponent: float) -> tuple[float, FloatArray]:
        """Return (1/|p|) log Σ λ^p and its slope: the smooth log λmax for p > 0, the smooth -log λmin for p < 0."""
        powers = exponent * np.log(self.values)
        # Subtract the largest power before the exponential, which would overflow otherwise.
        top = powers.max()
        weights = np.exp(powers - top)
        total = weights.sum()
        size = abs(exponent)
        return float(top + np.log(total)) / size, np.sign(exponent) * weights / total / self.values


def _condition_number(m: FloatArray, blocks: Blocks) -> tuple[float, FloatArray]:
    """Return the logarithm of the smooth condition number, ½ log(‖M‖p ‖M⁻¹‖p), [12.12], and its derivative.

    It comes from powers of M and M⁻¹, which take a fraction of the time of the eigenvalues; from these where M is
    nearly singular.
    """
    inverse = _invert(m, blocks)
    if inverse is None:
        return _compute_spectral_condition(m)
    large, slope = _compute_schatten_norm(m, blocks)
    small, slope_small = _compute_schatten_norm(inverse, blocks)
    for block in blocks:
        # ∂ of a function of M⁻¹: -M⁻¹ (…) M⁻¹.
        slope[block] -= inverse[block] @ slope_small[block] @ inverse[block]
    return 0.5 * (large + small), 0.5 * slope


def _compute_schatten_norm(m: FloatArray, blocks: Blocks) -> tuple[float, FloatArray]:
    """Return log (tr M⁸)^(1/8) of a positive definite M and its derivative M⁷ / tr M⁸: the Schatten norm for p = 8."""
    size, total = float(np.trace(m)), 0.0
    slope = np.zeros_like(m)
    for block in blocks:
        # Divided by its trace, powers of M neither overflow nor underflow. Three products give the eighth power.
        first = m[block] / size
        second = first @ first
        fourth = second @ second
        total += float(np.sum(fourth * fourth))
        slope[block] = fourth @ (second @ first)
    return np.log(size) + np.log(total) / _SCHATTEN, slope / (total * size)


def _invert(m: FloatArray, blocks: Blocks) -> FloatArray | None:
    """Return M⁻¹ by Cholesky; None where M is so near to singular that its small eigenvalues are lost in it."""
    inverse = np.zeros_like(m)
    for block in blocks:
        factor, failed = dpotrf(m[block], lower=1)
        if failed:
            return None
        # LAPACK fills the lower triangle alone.
        lower, failed = dpotri(factor, lower=1)
        if failed:
            return None
        inverse[block] = np.tril(lower) + np.tril(lower, -1).T
    return inverse if np.trace(m) * np.trace(inverse) < _ILL_CONDITIONED else None


def _compute_spectral_condition(m: FloatArray) -> tuple[float, FloatArray]:
    spectrum = _Spectrum.from_information(m)
    large, slope_large = spectrum.compute_log_norm(_SCHATTEN)
    small, slope_small = spectrum.compute_log_norm(-_SCHATTEN)
    return 0.5 * (large + small), spectrum.compute_slope(0.5 * (slope_large + slope_small))


def _d_optimal(m: FloatArray) -> tuple[float, FloatArray]:
    """Return -log det M / b, which is the volume of the parameters' confidence ellipsoid, and its derivative."""
    spectrum = _Spectrum.from_information(m)
    b = len(m)
    return -float(np.log(spectrum.values).sum()) / b, spectrum.compute_slope(-1.0 / spectrum.values / b)


def _a_optimal(m: FloatArray) -> tuple[float, FloatArray]:
    """Return log trace M⁻¹, which is the sum of the parameters' variances, and its derivative."""
    spectrum = _Spectrum.from_information(m)
    value, slope = spectrum.compute_log_norm(-1.0)
    return value, spectrum.compute_slope(slope)


def _e_optimal(m: FloatArray) -> tuple[float, FloatArray]:
    """Return the smooth -log σmin, which is the worst direction among the parameters, and its derivative."""
    spectrum = _Spectrum.from_information(m)
    value, slope = spectrum.compute_log_norm(-_SCHATTEN)
    return 0.5 * value, spectrum.compute_slope(0.5 * slope)


def _build_condition_plus_inverse_sigma(weight: float) -> _OfInformation:
    """Return the criterion log of [12.14], cond(W) + k2 / σmin."""

    def criterion(m: FloatArray) -> tuple[float, FloatArray]:
        spectrum = _Spectrum.from_information(m)
        large, slope_large = spectrum.compute_log_norm(_SCHATTEN)
        small, slope_small = spectrum.compute_log_norm(-_SCHATTEN)
        condition, inverse = np.exp(0.5 * (large + small)), weight * np.exp(0.5 * small)
        # Derivative of the logarithm of a sum: both terms hold 1 / σmin, and the first alone σmax.
        share = condition / (condition + inverse)
        slope = 0.5 * (share * slope_large + slope_small)
        return float(np.log(condition + inverse)), spectrum.compute_slope(slope)

    return criterion


def _build_weighted_condition(a_priori: FloatArray, blocks: Blocks) -> _OfInformation:
    """Return the criterion log of the smooth cond(W diag(Z)), [12.15]; a_priori (b,) is |Z|."""
    sizes = np.outer(a_priori, a_priori)

    def criterion(m: FloatArray) -> tuple[float, FloatArray]:
        value, slope = _condition_number(m * sizes, blocks)
        return value, slope * sizes

    return criterion


def _add_entry_ratio(of_condition: Criterion, weight: float) -> Criterion:
    """Return the criterion log of [12.13], cond(W) + k1 max|Wij| / min|Wij| over the entries that are not zero.

    Both extremes are p-norms of the entries, as those of the singular values are.
    """

    def criterion(w: FloatArray) -> tuple[float, FloatArray]:
        log_condition, gradient = of_condition(w)
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


def build_smooth_criterion(
    choice: CriterionChoice,
    a_priori: FloatArray,
    deciding: ParameterSelection | None = None,
    *,
    structure: RowStructure | None = None,
    earlier: FloatArray | None = None,
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
    structure : RowStructure, optional
        Entries of W that are zero in every motion; none where left out.
    earlier : (r, b), optional
        Rows besides W / √N that stand for the information of earlier runs.

    Returns
    -------
    callable
        Value and ∂/∂W (r, b) at W (r, b).
    """
    check_criterion(choice)
    scope = deciding or ParameterSelection.select_all(len(a_priori))
    rows_of = structure or RowStructure.from_entries(np.ones((1, len(a_priori)), bool))
    # What earlier runs tell may join parameters of different limbs.
    blocks = rows_of.blocks if earlier is None else (...,)
    # All of them are logarithms: their differences are relative, and no criterion needs a scale of its own.
    of_variances = build_variance_criterion(scope, a_priori)
    criteria: Mapping[str, _OfInformation] = {
        "condition_number": partial(_condition_number, blocks=blocks),
        "d_optimal": _d_optimal,
        "a_optimal": _a_optimal,
        "e_optimal": _e_optimal,
        "equilibrated": partial(_condition_number, blocks=blocks),
        "condition_plus_inverse_sigma": _build_condition_plus_inverse_sigma(choice.weight),
        "weighted": _build_weighted_condition(a_priori, blocks),
        "parameters": of_variances,
        "separation": of_variances,
        "prediction": of_variances,
    }
    of_information = criteria[choice.name]
    # The joints' noise weighs their rows where variances count.
    weighted = of_information is of_variances
    # Earlier rows are constant: they change the value, and have no part in the gradient.
    before: float | FloatArray = 0.0
    if earlier is not None:
        rows_before = scope.weight_rows(earlier) if weighted else earlier
        before = rows_before.T @ rows_before

    def criterion(w: FloatArray) -> tuple[float, FloatArray]:
        rows = scope.weight_rows(w) if weighted else w
        value, slope = of_information(rows_of.compute_information(rows) + before)
        gradient = rows_of.multiply(rows, 2.0 * slope)
        return value, scope.weight_rows(gradient) if weighted else gradient

    return _add_entry_ratio(criterion, choice.weight) if choice.name == "equilibrated" else criterion


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
    median_scaled_condition_number : float
        Median of those of columns of equal size.
    """

    count: int
    best: CriterionValues
    median_condition_number: float
    median_scaled_condition_number: float = np.inf


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
    medians = (
        float(np.median([getattr(motion_values, name) for motion_values in values]))
        for name in ("condition_number", "scaled_condition_number")
    )
    return Baseline(len(values), best, *medians)


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
    scaled_condition_number : float
        That of W with columns of equal size, which does not depend on the units of the parameters. Of a small arm in
        SI units, [12.12] is a million of any motion.
    """

    condition_number: float
    criterion: float
    smallest_singular_value: float
    largest_singular_value: float
    log_determinant: float
    trace_of_inverse: float
    scaled_condition_number: float = np.inf


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
    # The triangular factor has the singular values of W, and the sizes of its columns, in few rows.
    factor = np.linalg.qr(scaled, mode="r")
    sizes = np.linalg.norm(factor, axis=0)
    sigma = np.linalg.svd(factor, compute_uv=False)
    of_equal = np.linalg.svd(factor / np.where(sizes > 0.0, sizes, 1.0), compute_uv=False)
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
        scaled_condition_number=_divide_or_infinite(float(of_equal[0]), float(of_equal[-1])),
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
