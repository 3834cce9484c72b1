"""A known model with more effects: only what is new is derived, compiled and tested for dependence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.effects import EffectChoice, columns_of
from dynident.errors import DynidentError
from dynident.regressors.base_parameters import DEFAULT_TOLERANCE, BaseParameters, random_observation, select_base
from dynident.regressors.model import Model, check_columns

_STATES_PER_COLUMN = 2


def extended_model(known: Model, added: Sequence[EffectChoice], *, tolerance: float = DEFAULT_TOLERANCE) -> Model:
    """The model of a known one's effects and more.

    Its base parameters are those of the known model and, behind them, those of the new columns that are independent:
    of dependent columns the earlier one is kept.

    Raises
    ------
    DynidentError
        For an unknown effect, an unfit joint, or an effect chosen twice with the same columns.
    """
    if not added:
        raise DynidentError("choose at least one effect to add", pointer="/effects")
    new = columns_of(added, known.signals)
    columns = (*known.columns, *new)
    check_columns(columns)
    whole = known.observation.extended(new, known.signals)
    n_states = _STATES_PER_COLUMN * whole.n_columns // known.robot.n + 20
    names = tuple(column.name for column in whole.columns)
    # At other states a column that is nearly dependent may pass for a dependent one: those of the model stay.
    found = select_base(random_observation(whole, n_states), names, tolerance, known.n_parameters)
    fresh = [k - known.n_parameters for k in found.kept if k >= known.n_parameters]
    observation = whole
    if len(fresh) < len(new):
        observation = known.observation.extended([new[k] for k in fresh], known.signals)
    effects = (*known.effects, *added)
    return Model(known.robot, effects, known.signals, columns, _grown(known, found, names), observation)


def _grown(known: Model, found: BaseParameters, names: tuple[str, ...]) -> BaseParameters:
    """Base parameters of all columns, from those of the known model's kept columns and the new ones behind them."""
    before, b, c = known.base, known.n_parameters, len(known.columns)
    shape = (found.count, c + len(names) - b)
    grouping, written = np.zeros(shape), np.zeros(shape, dtype=bool)
    grouping[:b, :c], written[:b, :c] = before.grouping, before.written
    grouping[:, c:], written[:, c:] = found.grouping[:, b:], found.written[:, b:]
    return BaseParameters(
        names=before.names + names[b:],
        kept=before.kept + tuple(k - b + c for k in found.kept if k >= b),
        grouping=grouping,
        written=written,
        without_effect=before.without_effect + tuple(k - b + c for k in found.without_effect),
        rank=before.rank + found.rank - b,
    )
