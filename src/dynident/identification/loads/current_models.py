"""Identify a model in units of motor current, joint by joint, without drive gains (§12.3.6).

Divided by its unknown gain, the equation of one joint is u_j = Φ_j (χ / g_j): the current is as linear in χ / g_j as
the torque is in χ. Every joint then has parameters of its own, those that its equation tells apart, and predicts its
current without any gain being known. The price: χ is no longer the same in all equations, which tied the joints
together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice, ReferenceParameters, get_effect
from dynident.errors import DynidentError
from dynident.estimation import Errors, Reduction, Solution, Statistics, compute_errors, solve_weighted, statistics
from dynident.identification.equations.model_and_data_checks import check_recordings, check_temperature
from dynident.identification.loads.drive_gains import get_stated_gains, refuse_coupled_drives
from dynident.identification.loads.payloads_of_recordings import PLAIN_EFFECTS, scale_torque
from dynident.identification.strategies.sequential import select_joints
from dynident.identification.thresholds import ParameterJudgement, judge_parameter
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Preprocessing, Recording, choose_preprocessing
from dynident.regressors.base_parameters import BaseParameters, evaluate_at_random_states, select_base
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import Model, build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import Robot

_STATES = 400


@dataclass(frozen=True)
class CurrentParameter:
    """One parameter of a joint's current, χ / g.

    Parameters
    ----------
    name : str
        Name of the base parameter.
    value : float
        Its estimate in `unit`.
    unit : str
        Unit of χ over that of the gain.
    standard_deviation : float
        Standard deviation of the estimate in `unit`.
    interval : tuple of float
        Ends of the interval that holds the true value in 95 of 100 cases.
    judgement : str
        What the interval says of the value: "determined", "uncertain" or "zero_in_interval".
    grouping : str
        The base parameters that it is a sum of.
    """

    name: str
    value: float
    unit: str
    standard_deviation: float
    interval: tuple[float, float]
    judgement: ParameterJudgement
    grouping: str


@dataclass(frozen=True, eq=False)
class CurrentModel:
    """Model of the current of one joint.

    Parameters
    ----------
    joint : str
        Name of the joint.
    base : BaseParameters
        The model's base parameters, grouped by what this joint's equation tells apart.
    parameters : tuple of CurrentParameter
        The parameters with their uncertainty.
    solution : Solution
        Their estimates, in units of χ over those of the gain.
    statistics : Statistics
        Covariance of the estimates, in the same units.
    fit : Errors
        Errors of the current (A) on the data of the fit, in the row of the joint alone.
    held_out : Errors or None
        The same on held-out data; None where there is none.
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
    stated: Sequence[float] | None = None,
    preprocessing: Preprocessing | None = None,
    progress: Progress = ignore_progress,
) -> tuple[CurrentModel, ...]:
    """Identify every joint's parameters in units of its current (A), whatever its drive gain is.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    recordings, validation : sequences of Recording
        Data of the fit, and held-out data. Their torque over the stated gain is the current.
    effects : sequence of EffectChoice
        With values for all of their shape constants.
    stated : sequence of float, optional
        Gains that the recordings' torque was computed with; those of the robot's drives where left out, else 1.
    preprocessing : Preprocessing, optional
        Filters; from the data where left out.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    tuple of CurrentModel
        One for each joint.

    Raises
    ------
    DynidentError
        For an effect that rests on predicted torque or has a constant to be searched for, motors that act on several
        joints, or data that do not determine a joint's parameters.
    """
    refuse_coupled_drives(robot, "current units are identified joint by joint for")
    # Files usually hold torque that somebody computed from the current; dividing by that gain undoes it.
    gains = get_stated_gains(robot, stated)
    check_current_effects(effects)
    check_recordings(robot, recordings, validation)
    check_temperature(effects, recordings, validation)
    model = build_model(robot, effects)
    chosen = preprocessing or choose_preprocessing(recordings)
    nothing = ReferenceParameters.massless(robot)
    training = reduce_recordings(
        model.observation, RegressorInputs(recordings, chosen, nothing), scale_progress(progress, 0.0, 0.7)
    )
    held_out = None
    if validation:
        held_out = reduce_recordings(
            model.observation, RegressorInputs(validation, chosen, nothing), scale_progress(progress, 0.7, 0.95)
        )
        # The same for the held-out data, whose errors are in A, too.
        held_out = scale_torque(held_out, 1.0 / gains)
    # The recorded torque was computed with the stated gains; divided by these it is the current again.
    training = scale_torque(training, 1.0 / gains)
    # Which columns a joint's equation tells apart does not depend on the recordings: random states decide it.
    rows = evaluate_at_random_states(model.observation, _STATES).reshape(_STATES, robot.n, model.n_parameters)
    models = tuple(_identify_current(model, joint, rows[:, joint], training, held_out) for joint in range(robot.n))
    progress(1.0, "solved")
    return models


def check_current_effects(effects: Sequence[EffectChoice]) -> None:
    """Raise for effects that no joint's current shows by itself.

    Parameters
    ----------
    effects : sequence of EffectChoice
        Effects with their shape constants.

    Raises
    ------
    DynidentError
        For an effect that needs the load, acts in some runs alone, or lacks a shape constant.
    """
    for index, choice in enumerate(effects):
        effect = get_effect(choice.effect, f"/effects/{index}")
        open_ones = [spec.name for spec in effect.shapes if spec.name not in choice.shape_values]
        reason = ""
        if effect.needs_load:
            reason = "depends on the predicted torque, which is unknown without the gains; leave it out"
        elif effect.in_some_runs:
            reason = "acts only in some runs, but here all runs are treated alike; leave it out"
        elif open_ones:
            reason = (
                f"has shape constants that this method does not search for: give {', '.join(open_ones)}, or leave it "
                "out"
            )
        if reason:
            raise DynidentError(f"{choice.effect} {reason}", pointer=f"/effects/{index}", title="Unfit effect")


def _identify_current(
    model: Model, joint: int, rows: FloatArray, training: Reduction, held_out: Reduction | None
) -> CurrentModel:
    """Identify the current of one joint from its own equation."""
    # A single equation tells fewer parameters apart than all together, so they are regrouped for this joint.
    base = select_base(rows, tuple(column.name for column in model.kept))
    kept_columns = np.array(base.kept, dtype=np.intp)
    # Only this joint's equation, in the columns that it tells apart.
    own = select_joints(training, (joint,)).select_columns(kept_columns)
    name = model.robot.joint_names[joint]
    # A column of zeros would be fitted perfectly by zeros.
    if not own.equations[joint].whole_factor[:, -1].any():
        raise DynidentError(f"the current of {name} is zero everywhere", pointer="/recordings", title="No current")
    solution = solve_weighted(own)
    certainty = statistics(own, solution)
    per_unit = f"A/({model.robot.joints[joint].effort_unit})"
    parameters = tuple(
        CurrentParameter(
            model.kept[k].name,
            float(value),
            f"{model.kept[k].unit} {per_unit}",
            float(deviation),
            (float(value - half), float(value + half)),
            judge_parameter(float(value), float(deviation), float(half), owed=False),
            grouping,
        )
        for k, value, deviation, half, grouping in zip(
            base.kept,
            solution.values,
            certainty.standard_deviations,
            certainty.half_widths(),
            base.groupings,
            strict=True,
        )
    )
    held_out_errors = (
        None
        if held_out is None
        else compute_errors(select_joints(held_out, (joint,)).select_columns(kept_columns), solution.values)
    )
    return CurrentModel(
        name, base, parameters, solution, certainty, compute_errors(own, solution.values), held_out_errors
    )
