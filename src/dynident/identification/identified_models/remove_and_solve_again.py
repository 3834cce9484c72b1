"""Remove effects, or solve again with other choices, from reduced data alone; no recording is read.

Effects are removed by algebra on the reduced data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice, build_columns, get_effect
from dynident.effects.effect_columns import find_joints
from dynident.effects.effect_text_format import format_constant
from dynident.errors import DynidentError
from dynident.estimation import Reduction
from dynident.identification.description_prior import check_known
from dynident.identification.estimators.feasible_problem import (
    find_resisting_speeds,
    list_friction_bounds,
    list_unbounded_joints,
)
from dynident.identification.identification_choices import IdentificationChoices
from dynident.identification.identified_models.fit_model import SubmodelRelation, finalise_identification
from dynident.identification.identified_models.identification_result import NONE_IN_MEMORY, Identification, LadderStep
from dynident.identification.methods.base_classes import ESTIMATORS, STRATEGIES
from dynident.identification.shape_refinement import list_shape_variables
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.regressors.base_parameters import find_base_parameters_among
from dynident.regressors.model_structure import Model, build_model, check_columns
from dynident.robot import Robot
from dynident.simulation.true_effects import list_possibly_negative

_RECORDINGS_NEEDED = "Recordings needed"


@single_threaded
def reidentify(identification: Identification, choices: IdentificationChoices) -> Identification:
    """Solve an identified model again with another strategy, estimator, prior or fewer effects.

    Predicted loads stay those that the data were reduced with.

    Parameters
    ----------
    identification : Identification
        The model to solve again, with its reduced data.
    choices : IdentificationChoices
        The model's rows and their constants must be the same, and its effects a part of the old ones.

    Returns
    -------
    Identification
        Solved from the same reduced data.

    Raises
    ------
    DynidentError
        Where the choices need more than the reduced data: other rows or filters, effects that are not in them, or an
        estimator or strategy that goes through the samples again.
    """
    check_reduced_data(identification, choices)
    known = identification.model
    check_known(known, choices.known)
    model, part, data = known, None, identification.data
    if choices.effects != known.effects:
        model, weights = build_submodel(known, choices.effects, choices.tolerance)
        part, data = SubmodelRelation(known, weights), data.combine_columns(weights)
    # The filters are those that the reduced data went through, whatever the choices leave open.
    choices, lost = choices.move_known(known, model)
    chosen = replace(choices, preprocessing=identification.choices.preprocessing)
    identified = finalise_identification(
        model,
        chosen,
        data.to_data(identification.estimate.reference),
        data,
        part,
        # Fewer effects need no new rows: the smaller model's columns are linear combinations of those that the
        # reduced data hold.
        lambda _: combine_shapes(identification, model.effects, None if part is None else part.weights),
    )
    # Rows in memory belong to the columns of the larger model, so a smaller one starts without any.
    in_memory = identification.in_memory if part is None else NONE_IN_MEMORY
    return identified.with_warnings(lost).with_changes(in_memory=in_memory)


@dataclass(frozen=True, eq=False)
class PhysicalModel:
    """A model that can be simulated: a robot that can exist, whose friction resists.

    Parameters
    ----------
    identification : Identification
        The identified model itself, or the nearest one to its data that a robot can be.
    impossible : tuple of str
        What no robot has of the identified one, a few words each; none where it can be simulated as it is.
    note : str
        The same with what the change costs, a sentence; empty where nothing was changed.
    """

    identification: Identification
    impossible: tuple[str, ...] = ()
    note: str = ""

    @property
    def is_possible(self) -> bool:
        """Whether `identification` can be simulated."""
        return not self.impossible or bool(self.note)

    @property
    def warning(self) -> str:
        """What users of `identification` must know of it, a sentence; empty where nothing was or is impossible."""
        if self.is_possible:
            return self.note
        return f"A simulation with these parameters could gain energy: {'; '.join(self.impossible)}."


@single_threaded
def make_physical(identification: Identification) -> PhysicalModel:
    """Return a model that can be simulated, solved again from the same data where the identified one cannot be.

    Least squares may give a rotor, a mass matrix or friction that no robot has, where that fits the data better. It
    predicts torque near the recorded motion, but a simulation with it gains energy from nowhere.

    Parameters
    ----------
    identification : Identification
        The identified model, with its reduced data.

    Returns
    -------
    PhysicalModel
        The model, and what had to be changed. It is the identified one, with what is impossible in it, where its data
        cannot be solved again.
    """
    impossible = tuple(list_impossible(identification))
    # Poses at rest determine no inertia, so that there is nothing to solve again for.
    if not impossible or identification.model.is_at_rest:
        return PhysicalModel(identification, impossible)
    solved = _SOLVED.get(identification)
    if solved is None:
        solved = _solve_physical(identification, impossible)
        # What still contains the identified model would keep it in memory for ever.
        if solved.identification is not identification:
            _SOLVED[identification] = solved
    return solved


# Models that were solved again: each export and each simulation of a model asks for the same one.
_SOLVED: WeakKeyDictionary[Identification, PhysicalModel] = WeakKeyDictionary()


def _solve_physical(identification: Identification, impossible: tuple[str, ...]) -> PhysicalModel:
    try:
        choices = replace(identification.choices, estimator="feasible", strategy="global")
        possible = reidentify(identification, choices)
    except DynidentError:
        return PhysicalModel(identification, impossible)
    if list_impossible(possible):
        return PhysicalModel(identification, impossible)
    before, after = (
        model.fit_judged if model.held_out_judged is None else model.held_out_judged
        for model in (identification, possible)
    )
    data = "the data of the fit" if identification.held_out_judged is None else "held-out data"
    note = (
        f"The identified parameters are not those of a robot that can exist ({'; '.join(impossible)}), and would gain "
        "energy in a simulation. These are the feasible ones that fit the same data best: the error on "
        f"{data} is {format_percent(after.relative_total)} instead of {format_percent(before.relative_total)}."
    )
    return PhysicalModel(possible, impossible, note)


def list_impossible(identification: Identification) -> list[str]:
    """Return what makes a simulation of a model impossible, a few words each."""
    model, values = identification.model, identification.values
    speeds = find_resisting_speeds(model, identification.estimate.speeds)
    signed = list_possibly_negative(model.columns, list_unbounded_joints(model, speeds))
    rounding = _ROUNDING * float(np.abs(values).max(initial=0.0))
    reasons = [
        f"{column.name} = {value:.3g} {column.unit}"
        for k, column, value in zip(model.base.kept, model.kept, values, strict=True)
        if value < -rounding and not signed[k]
    ]
    if identification.worst_inertia_eigenvalue <= 0:
        reasons.append("an inertia matrix that is not positive definite in every posture")
    return reasons + _list_driving_friction(model, values, speeds)


def list_held_friction(identification: Identification) -> list[tuple[str, float]]:
    """Return the joints whose identified friction falls beyond the recorded speeds, with these, in rad/s or m/s.

    Programs hold it there (`effects.friction.bound_friction`).
    """
    speeds = identification.estimate.speeds
    if speeds is None:
        return []
    model, standard = identification.model, _spread_over_columns(identification.model, identification.values)

    def sum_friction(factor: float) -> dict[tuple[str, float], float]:
        return {
            (bound.name, bound.share): float(bound.weights @ standard[bound.columns])
            for bound in list_friction_bounds(model, factor * speeds)
            if abs(bound.share) == 1.0
        }

    at_speeds, beyond = sum_friction(1.0), sum_friction(_BEYOND)
    falling = {
        name for (name, share), torque in at_speeds.items() if beyond[name, share] < (1 - _NOTABLE_FALL) * torque
    }
    return [
        (joint, float(speed))
        for joint, speed in zip(model.robot.joint_names, speeds, strict=True)
        if f"friction of {joint}" in falling
    ]


# How far beyond the recorded speeds friction is looked at, as a multiple of them, and the share of it whose loss
# counts: the end of a curve that has nearly settled is none.
_BEYOND, _NOTABLE_FALL = 1.5, 0.01


def _spread_over_columns(model: Model, values: FloatArray) -> FloatArray:
    # Columns that others absorbed are zero here, and in the others.
    standard = np.zeros(len(model.columns))
    standard[list(model.base.kept)] = values
    return standard


def _list_driving_friction(model: Model, values: FloatArray, speeds: FloatArray) -> list[str]:
    standard = _spread_over_columns(model, values)
    names = [
        bound.name
        for bound in list_friction_bounds(model, speeds)
        if bound.weights @ standard[bound.columns] < -_ROUNDING * np.abs(bound.weights * standard[bound.columns]).sum()
    ]
    return [f"{name} that drives it" for name in dict.fromkeys(names)]


# Share of the largest parameter that the solver of feasible parameters leaves by rounding.
_ROUNDING = 1e-7


def check_reduced_data(identification: Identification, choices: IdentificationChoices) -> None:
    """Raise where choices need more than the reduced data of an identification.

    Parameters
    ----------
    identification : Identification
        The identified model.
    choices : IdentificationChoices
        The choices to solve it again with.

    Raises
    ------
    DynidentError
        Names the choice that needs the recordings, and what is possible without them.
    """
    old = identification.choices
    if (choices.model, choices.pole, choices.interval) != (old.model, old.pole, old.interval):
        raise _recordings_needed_error("/model", f"the reduced data contain rows of the {old.model} model")
    if old.model == "base_wrench" and choices.solver.weighted != old.solver.weighted:
        raise _recordings_needed_error(
            "/estimator",
            "the parameters that only the wrench shows were removed with the weights of the other estimator",
        )
    if not choices.solver.from_reduced:
        able = ", ".join(ESTIMATORS.names_with("from_reduced"))
        reason = f"{choices.solver.name} needs the samples; with reduced data only these are possible: {able}"
        raise _recordings_needed_error("/estimator", reason)
    if not choices.plan.from_reduced:
        able = ", ".join(STRATEGIES.names_with("from_reduced"))
        reason = f"{choices.strategy} needs runs of single joints; with reduced data only these are possible: {able}"
        raise _recordings_needed_error("/strategy", reason)
    if choices.preprocessing not in (None, old.preprocessing, identification.preprocessing):
        raise _recordings_needed_error("/preprocessing", "the reduced data were filtered with other settings")


def _recordings_needed_error(pointer: str, why: str) -> DynidentError:
    return DynidentError(f"{why}; identify from the recordings", pointer=pointer, title=_RECORDINGS_NEEDED)


_TITLE = "Nothing to remove"


@single_threaded
def remove(identification: Identification, removed: Sequence[EffectChoice]) -> Identification:
    """Take effects out of an identified model and solve again for the parameters that are left.

    The columns of the smaller model are combinations of those that the reduced data hold, so the result is that of
    identifying it anew. Predicted loads stay those of the larger model.

    Parameters
    ----------
    identification : Identification
        The identified model.
    removed : sequence of EffectChoice
        Each is taken off its joints, or off all where it names none; with shape constants or runs only what has these.

    Returns
    -------
    Identification
        The next step of the ladder.

    Raises
    ------
    DynidentError
        Where one of them is not in the model, or nothing would be left.
    """
    known = identification.model
    remaining = subtract_effects(identification.choices.effects, removed, known.robot)
    choices = replace(identification.choices, effects=remaining)
    model, weights = build_submodel(known, remaining, choices.tolerance)
    choices, lost = choices.move_known(known, model)
    smaller = solve_submodel(identification, model, choices, weights).with_warnings(lost)
    return smaller.with_changes(step=LadderStep(identification, removed=tuple(removed)))


def solve_submodel(
    identification: Identification,
    model: Model,
    choices: IdentificationChoices,
    weights: FloatArray,
    shaped: Callable[[FloatArray], Reduction | None] | None = None,
) -> Identification:
    """Solve for a smaller model from the reduced data of a larger one.

    Parameters
    ----------
    identification : Identification
        The larger model.
    model : Model
        The smaller one.
    choices : IdentificationChoices
        Those of the smaller one.
    weights : (b, b')
        The smaller model's columns are the larger one's times these.
    shaped : function, optional
        Takes parameters (b',), and returns the torques in the smaller model's columns, followed by those of its shape
        constants; by default these are the larger model's.

    Returns
    -------
    Identification
        The smaller model, without a step of a ladder.
    """
    data = identification.data.combine_columns(weights)
    to_solve = data.to_data(identification.estimate.reference)
    relation = SubmodelRelation(identification.model, weights)
    shaped = shaped or (lambda _: combine_shapes(identification, choices.effects, weights))
    return finalise_identification(model, choices, to_solve, data, relation, shaped)


def subtract_effects(
    effects: Sequence[EffectChoice], removed: Sequence[EffectChoice], robot: Robot
) -> tuple[EffectChoice, ...]:
    """Return the effects that remain when others are removed, wholly or from some joints.

    Parameters
    ----------
    effects, removed : sequence of EffectChoice
        Effects of a model, and those to take out of it.
    robot : Robot
        The robot that they act on.

    Returns
    -------
    tuple of EffectChoice
        The effects that remain, some on fewer joints.

    Raises
    ------
    DynidentError
        Where one of them is not there, or nothing would be left.
    """
    remaining = tuple(effects)
    for index, choice in enumerate(removed):
        pointer = f"/effects/{index}"
        find_joints(choice, robot, pointer)
        # Where nothing changes, the effect was not in the model on these joints.
        rest = tuple(part for choice_before in remaining for part in _subtract_effect(choice_before, choice, robot))
        if rest == remaining:
            place = f" on {', '.join(choice.joints)}" if choice.joints else ""
            place += "".join(f", {format_constant(choice.effect, name, value)}" for name, value in choice.shape)
            names = ", ".join(dict.fromkeys(present.effect for present in remaining))
            detail = f"the model has no {choice.effect}{place}; it has: {names}"
            raise DynidentError(detail, pointer=pointer, title=_TITLE)
        remaining = rest
    if not remaining:
        raise DynidentError("the model would have no effects left; keep at least one effect", pointer="/effects")
    return remaining


def _subtract_effect(choice: EffectChoice, removed: EffectChoice, robot: Robot) -> tuple[EffectChoice, ...]:
    """Remove an effect from one choice: return the choice itself, the same on fewer joints, or nothing."""
    # A choice without shape constants or runs stands for all of them.
    other_shape = not set(removed.shape) <= set(choice.shape)
    other_runs = bool(removed.runs) and removed.runs != choice.runs
    if choice.effect != removed.effect or other_shape or other_runs:
        return (choice,)
    # An effect of the whole robot has no joints to be taken from one by one.
    if get_effect(choice.effect).scope == "robot":
        return ()
    gone = find_joints(removed, robot)
    before = find_joints(choice, robot)
    remaining = [joint for joint in before if joint not in gone]
    if len(remaining) == len(before):
        return (choice,)
    return (replace(choice, joints=tuple(robot.joint_names[j] for j in remaining)),) if remaining else ()


def build_submodel(known: Model, effects: Sequence[EffectChoice], tolerance: float) -> tuple[Model, FloatArray]:
    """Build the model of some of a model's effects, without compiling anything.

    Parameters
    ----------
    known : Model
        The larger model.
    effects : sequence of EffectChoice
        Effects of the smaller model.
    tolerance : float
        Which columns count as dependent.

    Returns
    -------
    tuple of Model and array (b, b')
        The model, and its columns as combinations of those of the larger one.

    Raises
    ------
    DynidentError
        Where an effect has columns that the known model does not.
    """
    where = {column.key: k for k, column in enumerate(known.columns)}
    columns = build_columns(effects, known.signals)
    check_columns(columns)
    strangers = sorted({column.effect for column in columns if column.key not in where})
    if strangers:
        raise DynidentError(
            f"the reduced data have no columns for {', '.join(strangers)}; identify from the recordings",
            pointer="/effects",
            title="Recordings needed",
        )
    # The base parameters of the smaller model follow from those of the larger one: no random states are evaluated.
    base = find_base_parameters_among(known.base, known.observation, [where[c.key] for c in columns], tolerance)
    model = build_model(known.robot, effects, tolerance=tolerance, signals=known.signals, base=base)
    return model, _express_columns(known, model)


def combine_shapes(
    identification: Identification, effects: Sequence[EffectChoice], weights: FloatArray | None = None
) -> Reduction | None:
    """Return the rows that tell how sure shape constants are, for a model of some of the effects.

    Parameters
    ----------
    identification : Identification
        The larger model.
    effects : sequence of EffectChoice
        Effects of the smaller one.
    weights : (b, b'), optional
        The smaller model's columns as combinations of the larger one's; the same columns by default.

    Returns
    -------
    Reduction or None
        None where there are no constants, or where an effect now acts on fewer joints than its constant was linearised
        for.
    """
    before, after = list_shape_variables(identification.model.effects), list_shape_variables(effects)
    where = {(identification.model.effects[p.choice], p.spec.name): k for k, p in enumerate(before)}
    constants = [(effects[p.choice], p.spec.name) for p in after]
    shaped = identification.data.shaped
    # A constant that was linearised on more joints has other derivatives on fewer.
    if shaped is None or not constants or any(constant not in where for constant in constants):
        return None
    b = identification.model.n_parameters
    own = np.eye(b) if weights is None else weights
    # Columns of the parameters are combined by `weights`; the columns of the shape constants behind them stay as they
    # are.
    whole = np.zeros((b + len(before), own.shape[1] + len(constants)))
    whole[:b, : own.shape[1]] = own
    for k, constant in enumerate(constants):
        whole[b + where[constant], own.shape[1] + k] = 1.0
    return shaped.combine_columns(whole)


def _express_columns(known: Model, smaller: Model) -> FloatArray:
    """Return the smaller model's columns in terms of those that the known model keeps (b, b').

    Mostly these are the same columns. One that was absorbed by what is removed comes back as its combination.
    """
    where = {column.key: k for k, column in enumerate(known.columns)}
    return np.asarray(known.base.grouping[:, [where[column.key] for column in smaller.kept]])
