"""The formulation that needs no drive gain [Khalil 93], [Gautier 94] (§12.3.6): parameters in units of current.

Divided by its unknown gain, the equation of one joint is u_j = Φ_j (χ / g_j): the current is as linear in χ / g_j as
the torque is in χ. Every joint then has parameters of its own, those that its equation tells apart, and predicts its
current without any gain being known. Lost is what ties the joints together: that χ is the same in all equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import EffectChoice, effect_by_id
from dynident.errors import DynidentError
from dynident.estimation import Errors, Reduction, Solution, Statistics, errors, statistics, weighted
from dynident.identification.checks import check_recordings
from dynident.identification.loads.payloads import PLAIN_EFFECTS
from dynident.identification.strategies.sequential import only
from dynident.recordings import Preprocessing, Recording, choose_preprocessing
from dynident.regressors.base_parameters import BaseParameters, random_observation, select_base
from dynident.regressors.model import Model, build_model
from dynident.regressors.stream import reduce_recordings
from dynident.robot import Robot
from dynident.threads import single_threaded

_STATES = 400


@dataclass(frozen=True)
class CurrentParameter:
    """One parameter of a joint's current: χ / g with its unit, and the base parameters that it is a sum of."""

    name: str
    value: float
    standard_deviation: float
    unit: str
    grouping: str


@dataclass(frozen=True, eq=False)
class CurrentModel:
    """What the currents of one joint are made of.

    `base` groups the model's base parameters by what this joint's equation tells apart; `solution` and `statistics`
    are of these, in units of χ over those of the gain; `fit` and `held_out` the errors of its current.
    """

    joint: str
    base: BaseParameters
    parameters: tuple[CurrentParameter, ...]
    solution: Solution
    statistics: Statistics
    fit: Errors
    held_out: Errors | None


@single_threaded
def identify_currents(
    robot: Robot,
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    *,
    effects: Sequence[EffectChoice] = PLAIN_EFFECTS,
    preprocessing: Preprocessing | None = None,
) -> tuple[CurrentModel, ...]:
    """Identify every joint's parameters in units of its current, from recordings whose torque columns are currents.

    Parameters
    ----------
    robot : Robot
    recordings, validation : sequences of Recording
        Imported with gains of one, so that "torque" is the current (A).

    Raises
    ------
    DynidentError
        For an effect that rests on predicted torque, or data that do not determine a joint's parameters.
    """
    for index, choice in enumerate(effects):
        if effect_by_id(choice.effect, f"/effects/{index}").needs_load:
            raise DynidentError(
                f"{choice.effect} rests on the predicted torque, which nobody knows without the gains; leave it out",
                pointer=f"/effects/{index}",
                title="Unfit effect",
            )
    check_recordings(robot, recordings, validation)
    model = build_model(robot, effects)
    chosen = preprocessing or choose_preprocessing(recordings)
    zeros = np.zeros(10 * robot.tree.n)
    training = reduce_recordings(model.observation, recordings, chosen, zeros)
    held_out = reduce_recordings(model.observation, validation, chosen, zeros) if validation else None
    rows = random_observation(model.observation, _STATES).reshape(_STATES, robot.n, model.n_parameters)
    return tuple(_current_model(model, joint, rows[:, joint], training, held_out) for joint in range(robot.n))


def _current_model(
    model: Model, joint: int, rows: FloatArray, training: Reduction, held_out: Reduction | None
) -> CurrentModel:
    base = select_base(rows, tuple(column.name for column in model.kept))
    kept = np.array(base.kept, dtype=np.intp)
    own = only(training, (joint,)).select(kept)
    name = model.robot.joint_names[joint]
    if not own.equations[joint].joined[:, -1].any():
        raise DynidentError(f"the current of {name} is zero throughout", pointer="/measurement_ids", title="No current")
    solution = weighted(own)
    certainty = statistics(own, solution)
    per_unit = f"A/({model.robot.joints[joint].effort_unit})"
    parameters = tuple(
        CurrentParameter(
            model.kept[k].name, float(value), float(deviation), f"{model.kept[k].unit} {per_unit}", grouping
        )
        for k, value, deviation, grouping in zip(
            base.kept, solution.values, certainty.standard_deviations, base.groupings, strict=True
        )
    )
    judged = None if held_out is None else errors(only(held_out, (joint,)).select(kept), solution.values)
    return CurrentModel(name, base, parameters, solution, certainty, errors(own, solution.values), judged)
