"""How exciting a motion is: criteria of §12.3.4.1 and of optimal experiment design, with exact gradients.

Each is a function of the eigenvalues of M = WᵀW / N (N samples), so that neither the number of samples nor the
sampling rate changes what it says. Extreme singular values are not differentiable where they cross: the Schatten
p-norm, p = 8, takes their place while optimising, and the true value is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.excitation.variances import Deciding, relative_variances, sum_of_variances
from dynident.robot.model import FloatArray

Criterion = Callable[[FloatArray], tuple[float, FloatArray]]
"""Value and ∂/∂W (r, b) of a criterion at W (r, b), whose rows are divided by √N; the smaller the better."""

_SCHATTEN = 8.0
# Eigenvalues below this share of the largest are rounding errors: W has lost rank.
_FLOOR = 1e-14


@dataclass(frozen=True)
class CriterionChoice:
    """A criterion by name.

    Parameters
    ----------
    name : str
        One of `CRITERIA`.
    weight : float
        k1 of [12.13] or k2 of [12.14] (in the unit of the smallest singular value).
    a_priori : mapping of parameter name to value
        |Z| of [12.15]; parameters that it leaves out take the value that the robot's description gives. "parameters"
        and "separation" measure variances by them.
    parameters : tuple of str
        For "parameters": names of the base parameters whose variances count.
    effects : tuple of EffectChoice
        For "separation": the effects that are to be told from the rest of the model and from each other.
    """

    name: str = "condition_number"
    weight: float = 1.0
    a_priori: Mapping[str, float] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()
    effects: tuple[EffectChoice, ...] = ()


@dataclass(frozen=True)
class CriterionValues:
    """What a motion is worth, by every yardstick; singular values are those of W / √N.

    `condition_number` is [12.12], infinite where W has no full rank. `criterion` is the chosen criterion's value as
    the chapter writes it; `log_determinant` and `trace_of_inverse` are of M = WᵀW / N.
    """

    condition_number: float
    criterion: float
    smallest_singular_value: float
    largest_singular_value: float
    log_determinant: float
    trace_of_inverse: float


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """Eigenvalues (b,), ascending and above zero, and eigenvectors (b, b) of M."""

    values: FloatArray
    vectors: FloatArray

    @classmethod
    def of(cls, w: FloatArray) -> _Spectrum:
        values, vectors = np.linalg.eigh(w.T @ w)
        return cls(np.maximum(values, _FLOOR * values[-1] + np.finfo(float).tiny), vectors)

    def gradient(self, w: FloatArray, slope: FloatArray) -> FloatArray:
        """∂/∂W of a function of the eigenvalues with the derivatives `slope` (b,)."""
        made: FloatArray = 2.0 * (w @ ((self.vectors * slope) @ self.vectors.T))
        return made

    def log_norm(self, exponent: float) -> tuple[float, FloatArray]:
        """(1/|p|) log Σ λ^p and its slope: the smooth log λmax for p > 0, the smooth -log λmin for p < 0."""
        powers = exponent * np.log(self.values)
        top = powers.max()
        weights = np.exp(powers - top)
        total = weights.sum()
        size = abs(exponent)
        return float(top + np.log(total)) / size, np.sign(exponent) * weights / total / self.values


def condition_number(w: FloatArray) -> tuple[float, FloatArray]:
    """Logarithm of the smooth condition number, ½ log(‖M‖p ‖M⁻¹‖p); [12.12]."""
    spectrum = _Spectrum.of(w)
    large, slope_large = spectrum.log_norm(_SCHATTEN)
    small, slope_small = spectrum.log_norm(-_SCHATTEN)
    return 0.5 * (large + small), spectrum.gradient(w, 0.5 * (slope_large + slope_small))


def d_optimal(w: FloatArray) -> tuple[float, FloatArray]:
    """-log det M / b: the volume of the parameters' confidence ellipsoid."""
    spectrum = _Spectrum.of(w)
    b = w.shape[1]
    return -float(np.log(spectrum.values).sum()) / b, spectrum.gradient(w, -1.0 / spectrum.values / b)


def a_optimal(w: FloatArray) -> tuple[float, FloatArray]:
    """Log trace M⁻¹: the sum of the parameters' variances."""
    spectrum = _Spectrum.of(w)
    value, slope = spectrum.log_norm(-1.0)
    return value, spectrum.gradient(w, slope)


def e_optimal(w: FloatArray) -> tuple[float, FloatArray]:
    """Smooth -log σmin: the worst direction among the parameters."""
    spectrum = _Spectrum.of(w)
    value, slope = spectrum.log_norm(-_SCHATTEN)
    return 0.5 * value, spectrum.gradient(w, 0.5 * slope)


def condition_plus_inverse_sigma(weight: float) -> Criterion:
    """Log of [12.14], cond(W) + k2 / σmin."""

    def criterion(w: FloatArray) -> tuple[float, FloatArray]:
        spectrum = _Spectrum.of(w)
        large, slope_large = spectrum.log_norm(_SCHATTEN)
        small, slope_small = spectrum.log_norm(-_SCHATTEN)
        condition, inverse = np.exp(0.5 * (large + small)), weight * np.exp(0.5 * small)
        share = condition / (condition + inverse)
        slope = 0.5 * (share * slope_large + slope_small)
        return float(np.log(condition + inverse)), spectrum.gradient(w, slope)

    return criterion


def equilibrated(weight: float) -> Criterion:
    """Log of [12.13], cond(W) + k1 max|W| / min|W|, of columns instead of entries.

    Of single entries the smallest one tends to zero wherever a signal crosses zero, so sizes are those of columns:
    their root mean squares.
    """

    def criterion(w: FloatArray) -> tuple[float, FloatArray]:
        log_condition, gradient = condition_number(w)
        squares = np.einsum("ij,ij->j", w, w) + np.finfo(float).tiny
        sizes = _Spectrum(squares, np.eye(len(squares)))
        large, slope_large = sizes.log_norm(_SCHATTEN)
        small, slope_small = sizes.log_norm(-_SCHATTEN)
        condition, ratio = np.exp(log_condition), weight * np.exp(0.5 * (large + small))
        total = condition + ratio
        of_ratio = w * (slope_large + slope_small)  # ½ · 2 w · slope
        return float(np.log(total)), (condition / total) * gradient + (ratio / total) * of_ratio

    return criterion


def weighted(a_priori: FloatArray) -> Criterion:
    """Logarithm of the smooth cond(W diag(Z)), [12.15]; a_priori (b,) is |Z|."""

    def criterion(w: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = condition_number(w * a_priori)
        return value, gradient * a_priori

    return criterion


CRITERIA = (
    "condition_number",
    "equilibrated",
    "condition_plus_inverse_sigma",
    "weighted",
    "d_optimal",
    "a_optimal",
    "e_optimal",
    "parameters",
    "separation",
)
"""Names of the criteria."""


def check_criterion(choice: CriterionChoice) -> None:
    """Raise `DynidentError` for a name that is none, or a weight that is not a positive number."""
    if choice.name not in CRITERIA:
        raise DynidentError(
            f"there is no criterion {choice.name!r}; there are: {', '.join(CRITERIA)}",
            pointer="/criterion/name",
            title="Unknown criterion",
        )
    if not (np.isfinite(choice.weight) and choice.weight > 0):
        raise DynidentError(
            f"the weight of the criterion is {choice.weight}; it must be a positive number", pointer="/criterion/weight"
        )
    for name, value in choice.a_priori.items():
        if not (np.isfinite(value) and value != 0):
            raise DynidentError(
                f"the a-priori value of {name} is {value}; it must be a number other than zero",
                pointer="/criterion/a_priori",
            )


def check_wishes(choice: CriterionChoice) -> None:
    """Raise `DynidentError` where a criterion needs names that are not stated."""
    if choice.name == "parameters" and not choice.parameters:
        raise DynidentError("name the parameters whose variances count", pointer="/criterion/parameters")
    if choice.name == "separation" and not choice.effects:
        raise DynidentError("name the effects that are to be separated", pointer="/criterion/effects")


def criterion_of(choice: CriterionChoice, a_priori: FloatArray, deciding: Deciding | None = None) -> Criterion:
    """The function behind a choice.

    Parameters
    ----------
    a_priori : (b,)
        |Z| of [12.15].
    deciding : Deciding, optional
        Parameters that "parameters" and "separation" are about; all where not given.
    """
    check_criterion(choice)
    whose = deciding or Deciding.all_of(len(a_priori))
    of_w: Mapping[str, Criterion] = {
        "condition_number": condition_number,
        "d_optimal": d_optimal,
        "a_optimal": a_optimal,
        "e_optimal": e_optimal,
        "equilibrated": equilibrated(choice.weight),
        "condition_plus_inverse_sigma": condition_plus_inverse_sigma(choice.weight),
        "weighted": weighted(a_priori),
        "parameters": relative_variances(whose, a_priori),
        "separation": relative_variances(whose, a_priori),
    }
    return of_w[choice.name]


def true_values(
    choice: CriterionChoice, w: FloatArray, n_samples: int, a_priori: FloatArray, deciding: Deciding | None = None
) -> CriterionValues:
    """Values of W (r, b) at N samples without smoothing, by singular values."""
    scaled = w / np.sqrt(n_samples)
    sigma = np.linalg.svd(scaled, compute_uv=False)
    condition = _ratio(float(sigma[0]), float(sigma[-1]))
    full = np.isfinite(condition)
    inverse_squares = float(np.sum(sigma**-2)) if full else np.inf
    whose = deciding or Deciding.all_of(w.shape[1])
    log_determinant = float(2 * np.sum(np.log(sigma))) if full else -np.inf
    return CriterionValues(
        condition_number=condition,
        criterion=_as_written(choice, scaled, sigma, a_priori, whose, log_determinant, inverse_squares),
        smallest_singular_value=float(sigma[-1]),
        largest_singular_value=float(sigma[0]),
        log_determinant=log_determinant,
        trace_of_inverse=inverse_squares,
    )


def _as_written(
    choice: CriterionChoice,
    w: FloatArray,
    sigma: FloatArray,
    a_priori: FloatArray,
    deciding: Deciding,
    log_determinant: float,
    inverse_squares: float,
) -> float:
    condition = _ratio(float(sigma[0]), float(sigma[-1]))
    if choice.name == "equilibrated":
        sizes = np.linalg.norm(w, axis=0)
        return condition + choice.weight * _ratio(float(sizes.max()), float(sizes.min()))
    if choice.name == "condition_plus_inverse_sigma":
        return condition + (choice.weight / float(sigma[-1]) if np.isfinite(condition) else np.inf)
    if choice.name == "weighted":
        of_weighted = np.linalg.svd(w * a_priori, compute_uv=False)
        return _ratio(float(of_weighted[0]), float(of_weighted[-1]))
    if choice.name in ("parameters", "separation"):
        return sum_of_variances(deciding, a_priori, w)
    if choice.name == "d_optimal":
        return -log_determinant
    if choice.name == "a_optimal":
        return inverse_squares
    if choice.name == "e_optimal":
        return 1.0 / float(sigma[-1]) if np.isfinite(condition) else np.inf
    return condition


def _ratio(largest: float, smallest: float) -> float:
    """First over second, infinite where the second is rounding."""
    return largest / smallest if smallest > 1e-12 * largest else np.inf
