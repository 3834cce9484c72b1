"""Find the parameters that the data do not determine."""

from __future__ import annotations

import numpy as np

from dynident.estimation import EquationFactors, PriorInformation, Reduction, build_weighted_factor
from dynident.regressors.model import Model

# Share of the largest norm, or singular value, below which a column, or a direction, is rounding.
_TINY = 1e-9


def find_undetermined_parameters(
    model: Model, reduction: Reduction, known: PriorInformation | None = None
) -> list[str]:
    """Return the names of the parameters whose column is zero, or depends on the others, on this data.

    What is known beside the data counts as rows of it, in units of each equation's torque.

    Parameters
    ----------
    model : Model
    reduction : Reduction
    known : Information, optional
    """
    units = np.array([_get_row_unit(equation, known) for equation in reduction.equations])
    factor = build_weighted_factor(reduction, units, known)[:-1, :-1]
    norms = np.linalg.norm(factor, axis=0)
    largest = float(norms.max(initial=0.0))
    lost = norms <= _TINY * largest
    names = [column.name for column in model.kept]
    if lost.any() or largest == 0.0:
        return [names[k] for k in np.flatnonzero(lost)]
    _, singular, vt = np.linalg.svd(factor / norms)
    null = vt[singular <= _TINY * singular[0]]
    # All parameters with a noticeable part in an undetermined direction: naming only one of them would be arbitrary.
    involved = np.abs(null).max(axis=0, initial=0.0) > 0.05
    return [names[k] for k in np.flatnonzero(involved)]


def _get_row_unit(equation: EquationFactors, known: PriorInformation | None) -> float:
    """Return the unit that rows are counted in: 1 N m where nothing stands beside them, else the size of the torque."""
    size = float(np.linalg.norm(equation.joint_factor[:, -1])) / max(float(equation.counts.sum()), 1.0) ** 0.5
    return 1.0 if known is None or size == 0 else size
