"""The reaction wrench of the base as a source of the dynamic model's base parameters (§12.8; West, Raucent, Geffard).

Six equations show more than the joints' torques do: links' parameters that only load the base. They are appended to the
base parameters of the dynamic model as separate coordinates, so that the base parameters keep their meaning.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Column
from dynident.recordings.recording import WRENCH_NAMES
from dynident.regressors.base_parameters import DEFAULT_TOLERANCE, evaluate_at_random_states, select_base
from dynident.regressors.equation_forms import EquationForm, build_wrench_form
from dynident.regressors.model import Model

# Rows of the random observation matrix for every column: twice as many as would do.
_STATES_PER_COLUMN = 2
# Share of a base parameter that the wrench may leave open: what rounded right angles in a description make of it.
_LEFT_OPEN = 1e-3


@dataclass(frozen=True, eq=False)
class WrenchModel:
    """The equations of the base's wrench for one model.

    Parameters
    ----------
    form : EquationForm
        The six equations in c independent columns.
    coordinates : (c, e + b)
        Gives the parameters of these columns from e that only the wrench shows and, behind these, the model's b base
        parameters.
    n_extra : int
        Number e of parameters that only the wrench shows.
    unseen : tuple of str
        Names of base parameters that the wrench does not show.
    """

    form: EquationForm
    coordinates: FloatArray
    n_extra: int
    unseen: tuple[str, ...]


def build_wrench_model(model: Model, *, tolerance: float = DEFAULT_TOLERANCE) -> WrenchModel:
    """Build the equations of the base's wrench for a model.

    The wrench is that of all links of the model, of the base link and of the sensor's offsets.

    Parameters
    ----------
    model : Model
        The dynamic model whose base parameters are kept.
    tolerance : float
        Share of a column that may be left outside the others for it to count as dependent on them.

    Returns
    -------
    WrenchModel
        The equations, and their parameters in terms of the model's base parameters.
    """
    columns = (*model.columns, *_build_constant_columns(model.robot.n))
    whole = build_wrench_form(model.robot, columns, model.signals)
    names = tuple(column.name for column in columns)
    w = evaluate_at_random_states(whole.observation, _STATES_PER_COLUMN * len(columns) // 6 + 40)
    base = select_base(w, names, tolerance)
    independent = list(base.kept)
    # The six offsets of the sensor belong to no base parameter of the model.
    grouping = np.hstack([model.base.grouping, np.zeros((model.n_parameters, 6))])
    visible = grouping[:, independent]
    norms = np.linalg.norm(w, axis=0)
    unseen = _find_invisible_parameters(grouping, visible @ base.grouping, norms)
    # In columns of equal size, what is at right angles to the base parameters completes them.
    scaled = visible / norms[independent]
    q, _ = np.linalg.qr(scaled.T, mode="complete")
    extra = q[:, model.n_parameters :].T * norms[independent]
    # [extra; visible] leads from the parameters of the independent columns to the coordinates; its inverse leads back.
    coordinates = np.linalg.pinv(np.vstack([extra, visible]) / norms[independent]) / norms[independent][:, None]
    form = build_wrench_form(model.robot, [columns[k] for k in independent], model.signals)
    return WrenchModel(form, coordinates, len(extra), tuple(model.base.kept_names[k] for k in unseen))


def _find_invisible_parameters(grouping: FloatArray, reproduced: FloatArray, norms: FloatArray) -> list[int]:
    """Return the base parameters that are no combination of what the wrench shows, weighed by effect on it."""
    # A standard parameter without any effect on the wrench has infinite weight: if a base parameter holds one, the
    # wrench cannot determine it.
    size = np.where(norms > 0, 1.0 / np.where(norms > 0, norms, 1.0), np.inf)
    gap = np.where(grouping == reproduced, 0.0, np.abs(grouping - reproduced))
    with np.errstate(invalid="ignore"):
        whole = np.where(grouping == 0, 0.0, np.abs(grouping) * size)
        missing = np.where(gap == 0, 0.0, gap * size)
    finite = np.where(np.isfinite(whole), whole, 0.0).max(axis=1, initial=0.0)
    return [int(k) for k in np.flatnonzero(missing.max(axis=1, initial=0.0) > _LEFT_OPEN * finite)]


def _build_constant_columns(n: int) -> list[Column]:
    """Return one constant column for each component: the weight of the base link and the offsets of the sensor."""
    units = ("N",) * 3 + ("N m",) * 3
    return [
        Column("", name, name, "", unit, ca.SX(n, 1), wrench=partial(_build_unit_wrench, k))
        for k, (name, unit) in enumerate(zip(WRENCH_NAMES, units, strict=True))
    ]


def _build_unit_wrench(component: int) -> ca.SX:
    rows = ca.SX(6, 1)
    rows[component] = 1.0
    return rows
