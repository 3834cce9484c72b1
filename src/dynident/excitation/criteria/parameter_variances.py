"""Variances of chosen parameters as a criterion with gradient, and the standard deviations to expect from a design.

A variance is an entry of the diagonal of M⁻¹, all other columns present. For two rival effects A and B in one model
[base | A | B], 1 / (M⁻¹)aa is the squared distance of the contribution of A from the best that base and B can do
instead, for a unit amplitude: minimising the variance of A's parameter is T-optimality (Atkinson and Fedorov 1975) for
the pair.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.excitation.design_observation_matrix import DesignModel
from dynident.excitation.equation_type_rows import RowModel


@dataclass(frozen=True)
class ExpectedParameter:
    """Expected uncertainty of one base parameter.

    Parameters
    ----------
    name : str
        Name of the base parameter.
    effect : str
        Id of the effect that its column belongs to.
    link : str
        Name of the link or joint; "" for the whole robot.
    unit : str
        Unit of the parameter.
    share : float
        Part of its column that all others cannot replace, in [0, 1].
    standard_deviation : float or None
        In `unit`: what ordinary least squares weighted by the joints' noise reaches. None where no noise is stated,
        infinite where the motion does not determine the parameter.
    """

    name: str
    effect: str
    link: str
    unit: str
    share: float
    standard_deviation: float | None


def predict_uncertainties(
    model: DesignModel,
    w: FloatArray,
    dq: FloatArray,
    rows: RowModel,
    n_samples: float,
    *,
    noise: FloatArray | None,
    earlier: FloatArray | None = None,
) -> tuple[ExpectedParameter, ...]:
    """Return the expected uncertainty of the parameters.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    w, dq : (m, n, b), (m, n)
        W of the dynamic model and q̇ at m representative samples of the motion.
    rows : RowModel
        Rows that the identification makes of them.
    n_samples : float
        Number of samples of the experiment, each with noise of its own.
    noise : (n,), optional
        Standard deviation of a sample of every joint's torque.
    earlier : (r, b), optional
        Rows besides W / √m that stand for the information of earlier runs.

    Returns
    -------
    tuple of ExpectedParameter
        One for each base parameter of the chosen effects.
    """
    m = len(w)
    row_noise = np.ones(w.shape[1]) if noise is None else noise
    weighted_rows = rows.build_rows(w, dq)
    # A joined row is the sum over the joints, so its noise depends on the sample; it enters further below.
    if not rows.joined:
        weighted_rows = weighted_rows / np.tile(row_noise, m)[:, None]
    if earlier is not None:
        weighted_rows = np.concatenate(
            [weighted_rows, np.sqrt(m) * earlier / np.tile(row_noise, len(earlier) // len(row_noise))[:, None]]
        )
    # Rows in units of their noise: the inverse of WᵀW is then the covariance of the parameters.
    diagonal = compute_inverse_diagonal(weighted_rows)
    variances = diagonal.variances
    # Mixing in time and joining make the noise of rows differ and correlate; the inverse of WᵀW would not be the
    # covariance.
    if rows.joined or rows.mix is not None:
        lost = ~np.isfinite(variances)
        variances = np.where(lost, np.inf, _compute_estimator_variances(weighted_rows, rows, dq, row_noise))
    # m samples represent n_samples independent ones: variances fall with their number.
    deviations = np.sqrt(variances * m / n_samples)
    return tuple(
        ExpectedParameter(
            name=name,
            effect=column.effect,
            link=column.link,
            unit=column.unit,
            share=float(share),
            standard_deviation=None if noise is None else float(deviation),
        )
        for name, column, share, deviation in zip(
            model.parameter_names, model.base_columns, diagonal.shares, deviations, strict=False
        )
    )


def _compute_estimator_variances(
    solved_rows: FloatArray, rows: RowModel, dq: FloatArray, noise: FloatArray
) -> FloatArray:
    """Return variances (b,) of least squares on rows that are mixtures of the samples, and so have correlated noise."""
    m = len(dq)
    per_sample = len(solved_rows) // m
    # The estimate is this matrix times the rows; through the mixing it is a linear function of independent samples.
    solving = np.linalg.pinv(solved_rows).reshape(-1, m, per_sample)
    if rows.mix is not None:
        solving = np.einsum("brk,rm->bmk", solving, rows.mix, optimize=True)
    weights = np.ones(per_sample) if rows.joined else 1.0 / noise
    variances: FloatArray = ((solving * weights * rows.compute_unmixed_noise(dq, noise)) ** 2).sum(axis=(1, 2))
    return variances


# Eigenvalues of the equilibrated M below this share of the largest are rounding errors.
_FLOOR = 1e-13
_LOST = 1e-6
"""Squared share of a parameter in the directions that W does not excite, above which it counts as undetermined."""


@dataclass(frozen=True, eq=False)
class ParameterSelection:
    """Parameters whose variances count, and the weights of the joints' rows.

    Within a group relative variances are added; groups are weighed by the product of their sums, so that no unit
    decides which of them matters.

    Parameters
    ----------
    groups : tuple of tuple of int
        Indices of parameters; each group counts as one.
    row_weights : (n,)
        1 / noise of every joint.
    moments : (b, b), optional
        Mean of wᵀw over the rows w of the states whose torque is to be predicted. With it the variance of that torque
        counts, tr(M⁻¹ moments), instead of the groups (I-optimality; Atkinson and Donev 1992).
    """

    groups: tuple[tuple[int, ...], ...]
    row_weights: FloatArray
    moments: FloatArray | None = None

    @classmethod
    def select_all(cls, n_parameters: int) -> ParameterSelection:
        """Return all parameters in one group, all rows alike."""
        return cls((tuple(range(n_parameters)),), np.ones(1))

    def weight_rows(self, w: FloatArray) -> FloatArray:
        """Return W (m n, b) with the weights on its rows."""
        return w * np.tile(self.row_weights, len(w) // len(self.row_weights))[:, None]


def build_variance_criterion(
    deciding: ParameterSelection, a_priori: FloatArray
) -> Callable[[FloatArray], tuple[float, FloatArray]]:
    """Return the criterion: log of the (geometric mean over groups of the) sum of variances over a_priori² (b,).

    It is a function of M (b, b) of the weighted rows; with the value it returns the symmetric derivative by M.

    With moments in the selection it is the log of the variance of the predicted torque.

    Parameters
    ----------
    deciding : ParameterSelection
        Parameters that the criterion is about, and weights of the joints' rows.
    a_priori : (b,)
        Magnitudes |Z| of the parameters.
    """

    def criterion(m: FloatArray) -> tuple[float, FloatArray]:
        inverse = _invert_information(m)
        # d(M⁻¹) = -M⁻¹ dM M⁻¹
        if deciding.moments is not None:
            spread = inverse @ deciding.moments
            total = float(np.trace(spread))
            return float(np.log(total)), -(spread @ inverse) / total
        value, slope = _sum_groups(deciding.groups, np.diag(inverse), a_priori)
        return value, -(inverse * slope) @ inverse

    return criterion


def sum_variances(deciding: ParameterSelection, a_priori: FloatArray, w: FloatArray) -> float:
    """Return the criterion's value without its logarithm; infinite where a parameter is not determined.

    Parameters
    ----------
    deciding : ParameterSelection
        Parameters that the criterion is about, and weights of the joints' rows.
    a_priori : (b,)
        Magnitudes |Z| of the parameters.
    w : (r, b)
        Rows of W.
    """
    rows = deciding.weight_rows(w)
    variances = compute_inverse_diagonal(rows).variances
    indices = [k for group in deciding.groups for k in group]
    if not np.isfinite(variances[indices]).all():
        return np.inf
    if deciding.moments is not None:
        return float(np.trace(_invert_information(rows.T @ rows) @ deciding.moments))
    return float(np.exp(_sum_groups(deciding.groups, variances, a_priori)[0]))


def _sum_groups(
    groups: Sequence[tuple[int, ...]], variances: FloatArray, a_priori: FloatArray
) -> tuple[float, FloatArray]:
    value, slope = 0.0, np.zeros(len(variances))
    for group in groups:
        members = list(group)
        relative = variances[members] / a_priori[members] ** 2
        # The mean of logarithms is the logarithm of the geometric mean, whose optimum does not depend on the units of
        # the groups.
        value += float(np.log(relative.sum())) / len(groups)
        slope[members] += 1.0 / a_priori[members] ** 2 / relative.sum() / len(groups)
    return value, slope


def _invert_information(m: FloatArray) -> FloatArray:
    """Return M⁻¹ (b, b), by equilibrated columns so that units do not cost digits."""
    sizes = np.sqrt(np.diag(m)) + np.finfo(float).tiny
    values, vectors = np.linalg.eigh(m / np.outer(sizes, sizes))
    # A floor instead of an error: the optimiser may pass through motions that lose rank.
    values = np.maximum(values, _FLOOR * values[-1] + np.finfo(float).tiny)
    inverse: FloatArray = (vectors / values) @ vectors.T / np.outer(sizes, sizes)
    return inverse


@dataclass(frozen=True, eq=False)
class InverseDiagonal:
    """Diagonal of M⁻¹, and how independent every column is.

    Parameters
    ----------
    variances : (b,)
        Diagonal of M⁻¹, infinite where W does not determine a parameter.
    shares : (b,)
        In [0, 1]: the part of a column that the others cannot replace, by its norm. 1 for a column at right angles to
        them, 0 for one that they can replace.
    """

    variances: FloatArray
    shares: FloatArray


def compute_inverse_diagonal(w: FloatArray) -> InverseDiagonal:
    """Return variances of the parameters of W (r, b) for unit noise, and how independent every column is."""
    return compute_diagonal_from_information(w.T @ w)


def compute_diagonal_from_information(information: FloatArray) -> InverseDiagonal:
    """Return the same from the information matrix M (b, b)."""
    # A column of zeros has no direction of its own; scaled to any size it stays absent, and its variance is infinite.
    squares = np.diag(information)
    absent = squares <= 0
    sizes = np.sqrt(np.where(absent, 1.0, squares))
    values, vectors = np.linalg.eigh(information / np.outer(sizes, sizes))
    # Directions below the floor are left out of the inverse. A parameter that has a part in one of them is not
    # determined, whatever the other directions say.
    is_seen = values > _FLOOR * len(values) * values[-1]
    scaled = (vectors[:, is_seen] ** 2 / values[is_seen]).sum(axis=1)
    lost = absent | ((vectors[:, ~is_seen] ** 2).sum(axis=1) > _LOST)
    variances = np.where(lost, np.inf, scaled / sizes**2)
    # With columns of unit length, the diagonal of the inverse is one over the squared distance of a column from the
    # span of the others.
    shares = np.where(lost, 0.0, 1.0 / np.sqrt(np.maximum(scaled, 1.0)))
    return InverseDiagonal(variances, shares)
