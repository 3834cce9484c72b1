"""Expected uncertainty of every parameter after an experiment, before the robot moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray
from dynident.excitation.criteria.variances import compute_inverse_diagonal
from dynident.excitation.observation.model import DesignModel
from dynident.excitation.observation.row_models import RowModel


@dataclass(frozen=True)
class ExpectedParameter:
    """Expected uncertainty of one base parameter.

    Parameters
    ----------
    name, effect, link, unit : str
    share : float
        In [0, 1]: the part of its column that all others cannot replace.
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
    """
    m = len(w)
    row_noise = np.ones(w.shape[1]) if noise is None else noise
    weighted_rows = rows.build_rows(w, dq)
    if not rows.joined:
        weighted_rows = weighted_rows / np.tile(row_noise, m)[:, None]
    if earlier is not None:
        weighted_rows = np.concatenate(
            [weighted_rows, np.sqrt(m) * earlier / np.tile(row_noise, len(earlier) // len(row_noise))[:, None]]
        )
    diagonal = compute_inverse_diagonal(weighted_rows)
    variances = diagonal.variances
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
