"""How well every parameter will come out of an experiment, before the robot moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray
from dynident.excitation.criteria.variances import inverse_diagonal
from dynident.excitation.observation.model import DesignModel
from dynident.excitation.observation.row_models import RowModel


@dataclass(frozen=True)
class ExpectedParameter:
    """One base parameter.

    `share` in [0, 1] is what is left of its column beside all others; `standard_deviation`, in `unit`, is what
    ordinary least squares weighted by the joints' noise reaches, `None` where no noise is stated, infinite where the
    motion does not determine the parameter.
    """

    name: str
    effect: str
    link: str
    unit: str
    share: float
    standard_deviation: float | None


def expected_parameters(
    model: DesignModel,
    w: FloatArray,
    dq: FloatArray,
    rows: RowModel,
    n_samples: float,
    *,
    noise: FloatArray | None,
    earlier: FloatArray | None = None,
) -> tuple[ExpectedParameter, ...]:
    """What is to be expected of the parameters.

    Parameters
    ----------
    w, dq : (m, n, b), (m, n)
        W of the dynamic model and q̇ at m representative samples of the motion.
    rows : RowModel
        What the identification makes of them.
    n_samples : float
        Number of samples of the experiment, each with noise of its own.
    noise : (n,), optional
        Standard deviation of a sample of every joint's torque.
    earlier : (r, b), optional
        Rows beside W / √m that stand for earlier runs.
    """
    m = len(w)
    known = np.ones(w.shape[1]) if noise is None else noise
    made = rows.rows(w, dq)
    if not rows.joined:
        made = made / np.tile(known, m)[:, None]
    if earlier is not None:
        made = np.concatenate([made, np.sqrt(m) * earlier / np.tile(known, len(earlier) // len(known))[:, None]])
    found = inverse_diagonal(made)
    variances = found.variances
    if rows.joined or rows.mix is not None:
        lost = ~np.isfinite(variances)
        variances = np.where(lost, np.inf, _of_estimator(made, rows, dq, known))
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
            model.parameter_names, model.kept, found.shares, deviations, strict=False
        )
    )


def _of_estimator(made: FloatArray, rows: RowModel, dq: FloatArray, noise: FloatArray) -> FloatArray:
    """Variances (b,) of least squares on rows that are mixtures of the samples, and so have correlated noise."""
    m = len(dq)
    per_sample = len(made) // m
    solving = np.linalg.pinv(made).reshape(-1, m, per_sample)
    if rows.mix is not None:
        solving = np.einsum("brk,rm->bmk", solving, rows.mix, optimize=True)
    weights = np.ones(per_sample) if rows.joined else 1.0 / noise
    made_of: FloatArray = ((solving * weights * rows.unmixed_noise(dq, noise)) ** 2).sum(axis=(1, 2))
    return made_of
