"""How well every parameter will come out of an experiment, before the robot moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.excitation.model import DesignModel
from dynident.excitation.variances import inverse_diagonal
from dynident.robot.model import FloatArray


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
    model: DesignModel, w: FloatArray, row_weights: FloatArray, n_samples: float, *, noise_known: bool
) -> tuple[ExpectedParameter, ...]:
    """What is to be expected of the parameters.

    Parameters
    ----------
    w : (m n, b)
        At m representative samples of the motion.
    row_weights : (n,)
        One over the noise of a sample of every joint.
    n_samples : float
        Number of samples of the experiment, each with noise of its own.
    """
    m = len(w) // model.robot.n
    found = inverse_diagonal(w * np.tile(row_weights, m)[:, None])
    deviations = np.sqrt(found.variances * m / n_samples)
    return tuple(
        ExpectedParameter(
            name=name,
            effect=column.effect,
            link=column.link,
            unit=column.unit,
            share=float(share),
            standard_deviation=float(deviation) if noise_known else None,
        )
        for name, column, share, deviation in zip(
            model.parameter_names, model.kept, found.shares, deviations, strict=False
        )
    )
