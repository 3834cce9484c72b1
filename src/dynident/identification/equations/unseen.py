"""Which parameters data do not show."""

from __future__ import annotations

import numpy as np

from dynident.estimation import EquationFactors, Information, Reduction, weighted_factor
from dynident.regressors.model import Model

_TINY = 1e-9


def unseen_parameters(model: Model, reduction: Reduction, known: Information | None = None) -> list[str]:
    """Names of the parameters whose column is zero, or depends on the others, on this data.

    What is known beside the data counts as rows of it, in units of each equation's torque.
    """
    units = np.array([_unit(equation, known) for equation in reduction.equations])
    factor = weighted_factor(reduction, units, known)[:-1, :-1]
    norms = np.linalg.norm(factor, axis=0)
    largest = float(norms.max(initial=0.0))
    lost = norms <= _TINY * largest
    names = [column.name for column in model.kept]
    if lost.any() or largest == 0.0:
        return [names[k] for k in np.flatnonzero(lost)]
    _, singular, vt = np.linalg.svd(factor / norms)
    null = vt[singular <= _TINY * singular[0]]
    involved = np.abs(null).max(axis=0, initial=0.0) > 0.05
    return [names[k] for k in np.flatnonzero(involved)]


def _unit(equation: EquationFactors, known: Information | None) -> float:
    """What a row is counted in: N m as it is where nothing else stands beside it, else the size of the torque."""
    size = float(np.linalg.norm(equation.joined[:, -1])) / max(float(equation.counts.sum()), 1.0) ** 0.5
    return 1.0 if known is None or size == 0 else size
