"""Extend a model by more effects: only what is new is derived, compiled and tested for dependence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.effects import EffectChoice, build_columns
from dynident.errors import DynidentError
from dynident.regressors.base_parameters import (
    DEFAULT_TOLERANCE,
    BaseParameters,
    evaluate_at_random_states,
    select_base,
)
from dynident.regressors.model import Model, check_columns

_STATES_PER_COLUMN = 2


def extend_model(model: Model, added: Sequence[EffectChoice], *, tolerance: float = DEFAULT_TOLERANCE) -> Model:
    """Return a model with more effects.

    Its base parameters are those of the given model and, behind them, those of the new columns that are independent:
    of dependent columns the earlier one is kept.

    Parameters
    ----------
    model : Model
    added : sequence of EffectChoice
    tolerance : float
        Share of a column that may be left outside the others for it to count as dependent on them.

    Returns
    -------
    Model
        It shares the compiled observation matrix of the given one.

    Raises
    ------
    DynidentError
        For an unknown effect, an unfit joint, or an effect chosen twice with the same columns.
    """
    if not added:
        raise DynidentError("choose at least one effect to add", pointer="/effects")
    new = build_columns(added, model.signals)
    columns = (*model.columns, *new)
    check_columns(columns)
    whole = model.observation.extend(new, model.signals)
    n_states = _STATES_PER_COLUMN * whole.n_columns // model.robot.n + 20
    names = tuple(column.name for column in whole.columns)
    # At other states a column that is nearly dependent may pass for a dependent one: those of the model stay.
    selection = select_base(evaluate_at_random_states(whole, n_states), names, tolerance, model.n_parameters)
    fresh = [k - model.n_parameters for k in selection.kept if k >= model.n_parameters]
    observation = whole
    # The first extension has dependent columns among the new ones: another one without them is needed.
    if len(fresh) < len(new):
        observation = model.observation.extend([new[k] for k in fresh], model.signals)
    effects = (*model.effects, *added)
    return Model(
        model.robot, effects, model.signals, columns, _extend_base_parameters(model, selection, names), observation
    )


def _extend_base_parameters(model: Model, selection: BaseParameters, names: tuple[str, ...]) -> BaseParameters:
    """Return base parameters of all columns, from those of the model and the new ones behind its kept columns."""
    before, b, c = model.base, model.n_parameters, len(model.columns)
    shape = (selection.count, c + len(names) - b)
    grouping, written = np.zeros(shape), np.zeros(shape, dtype=bool)
    grouping[:b, :c], written[:b, :c] = before.grouping, before.written
    grouping[:, c:], written[:, c:] = selection.grouping[:, b:], selection.written[:, b:]
    return BaseParameters(
        names=before.names + names[b:],
        kept=before.kept + tuple(k - b + c for k in selection.kept if k >= b),
        grouping=grouping,
        written=written,
        without_effect=before.without_effect + tuple(k - b + c for k in selection.without_effect),
        rank=before.rank + selection.rank - b,
    )
