"""How far two effects can be told apart by data at hand, and by a motion that is only proposed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.diagnosis.comparing.compare import Comparison
from dynident.diagnosis.result import Separation
from dynident.excitation import DesignRequest, quick_motion
from dynident.excitation.criteria.variances import inverse_diagonal_of
from dynident.excitation.limits.bounds import Bounds
from dynident.excitation.observation.model import DesignModel
from dynident.excitation.trajectories.motion import Motion
from dynident.robot.model import FloatArray

IntArray = NDArray[np.intp]

_MOST_ROWS = 1500
"""Samples that a matrix of inner products is made from: beyond them only its precision grows, not what it says."""


@dataclass(frozen=True, eq=False)
class Information:
    """WᵀW (b, b) and Wᵀρ (b,) in units of the noise: what rows of data tell about the parameters."""

    matrix: FloatArray
    right: FloatArray

    def __add__(self, other: Information) -> Information:
        return Information(self.matrix + other.matrix, self.right + other.right)


def of_data(model: DesignModel, comparisons: Sequence[Comparison], row_weights: FloatArray) -> Information:
    """The information in recordings that a model was compared with; row_weights (n,) are one over the noise."""
    total = Information(np.zeros((model.n_parameters,) * 2), np.zeros(model.n_parameters))
    rows = sum(len(one.t) for one in comparisons)
    for one in comparisons:
        if len(one.t) < 2:
            continue
        step = float(np.median(np.diff(one.t)))
        jerk = np.gradient(one.ddq, step, axis=0)
        taken = _spread(len(one.t), rows)
        motion = Motion(step * np.arange(len(one.t), dtype=np.float64), one.q, one.dq, one.ddq, jerk)
        total += _information(model, motion, taken, one.residual[taken], row_weights, len(one.t))
    return total


def of_proposal(
    model: DesignModel, request: DesignRequest, bounds: Bounds, row_weights: FloatArray, rate: float
) -> Information:
    """The information that a design like this would give at `rate` rows a second, from a quickly made motion."""
    motion, n_rows = quick_motion(request, model, bounds, rate)
    taken = _spread(len(motion.t), len(motion.t))
    nothing = np.zeros((len(taken), model.robot.n))
    return _information(model, motion, taken, nothing, row_weights, n_rows)


def _information(
    model: DesignModel,
    motion: Motion,
    taken: IntArray,
    residual: FloatArray,
    row_weights: FloatArray,
    n_rows: float,
) -> Information:
    w = model.observe_along(motion, taken)
    weights = np.tile(row_weights, len(taken)) * np.sqrt(n_rows / len(taken))
    weighted = w * weights[:, None]
    return Information(weighted.T @ weighted, weighted.T @ (residual.reshape(-1) * weights))


def _spread(count: int, total: int) -> IntArray:
    """Evenly spread samples of a recording that is `count` of `total` rows."""
    wanted = max(1, min(count, round(_MOST_ROWS * count / total)))
    return np.unique(np.linspace(0, count - 1, wanted).astype(np.intp))


def amplitudes(found: Information, suspect: Sequence[int], rivals: Sequence[int]) -> FloatArray:
    """Parameters of the suspect alone, fitted to the residual beside the model and without its rivals."""
    kept = [k for k in range(len(found.right)) if k not in set(rivals) - set(suspect)]
    matrix, right = found.matrix[np.ix_(kept, kept)], found.right[kept]
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    solved = np.linalg.lstsq(matrix / np.outer(scale, scale), right / scale, rcond=1e-9)[0] / scale
    return np.asarray(solved[[kept.index(k) for k in suspect]])


def separation(model: DesignModel, known: Information, parameter: int, size: float | None) -> Separation:
    """How well a parameter comes out beside everything else in the model.

    `size` is its amplitude, None where nobody knows it.
    """
    found = inverse_diagonal_of(known.matrix)
    deviation = float(np.sqrt(found.variances[parameter]))
    column = model.kept[parameter]
    return Separation(
        parameter=column.name,
        unit=column.unit,
        share=float(found.shares[parameter]),
        standard_deviation=deviation,
        t_value=None if size is None else abs(size) / deviation,
    )
