"""A-priori magnitudes of the base parameters: the Z of [12.15]."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.excitation.criteria.choice import CriterionChoice
from dynident.excitation.observation.model import DesignModel
from dynident.robot.pointers import join_names

# Of the largest parameter of the same unit: smaller ones cannot be told from zero anyway, and must not rule.
_SMALLEST_SHARE = 0.01
_WHERE_UNKNOWN = 1.0


def find_a_priori_values(model: DesignModel, choice: CriterionChoice) -> tuple[FloatArray, tuple[str, ...]]:
    """Return |Z| (b,) of the effects' base parameters, and notes on what was assumed.

    Stated values come first, then the description's, never below 1 % of the largest of the same unit; one unit where
    neither has a value.

    Parameters
    ----------
    model : DesignModel
    choice : CriterionChoice

    Returns
    -------
    values : (b,)
    notes : tuple of str

    Raises
    ------
    DynidentError
        A stated value is for a parameter that does not exist.
    """
    names = model.parameter_names
    unknown = [name for name in choice.a_priori if name not in names]
    if unknown:
        raise DynidentError(
            f"there is no base parameter {join_names(unknown)}; there are: {join_names(names)}",
            pointer="/criterion/a_priori",
        )
    columns = model.base_columns[: model.n_parameters]
    units = np.array([column.unit for column in columns])
    values = np.abs(model.nominal_values[: model.n_parameters])
    for unit in set(units):
        same = units == unit
        values[same] = np.maximum(values[same], _SMALLEST_SHARE * values[same].max())
    assumed = []
    for k, name in enumerate(names):
        if name in choice.a_priori:
            values[k] = abs(choice.a_priori[name])
        elif values[k] == 0.0:
            values[k] = _WHERE_UNKNOWN
            assumed.append(name)
    note = f"A-priori values of {join_names(assumed)} were not given; 1 was assumed." if assumed else ""
    return values, ((note,) if note else ())
