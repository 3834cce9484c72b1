"""Values of a motion by every criterion as the chapter writes it (§12.3.4.1), and the baseline of random motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.excitation.criteria.criterion_choice import CriterionChoice
from dynident.excitation.criteria.parameter_variances import ParameterSelection, sum_variances
from dynident.excitation.criteria.smooth_criteria import find_nonzero_entries


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
    if choice.name in ("parameters", "separation"):
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
