"""From recordings to an identified model: everything that the choices leave open is found, then the model is solved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from dynident.arrays import FloatArray
from dynident.effects import EffectChoice, effect_by_id
from dynident.errors import DynidentError
from dynident.estimation import Linearised, Reduction, condition_number, errors, noise_levels
from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.checks import (
    check_recordings,
    check_reduction,
    check_runs,
    check_temperature,
    check_torque,
)
from dynident.identification.equations.data import Data, motions_and_friction, reduced, torque_of
from dynident.identification.equations.model_equations import with_constants
from dynident.identification.fit import Fit
from dynident.identification.parameters.inertia import smallest_inertia_eigenvalue
from dynident.identification.problem import Problem
from dynident.identification.shapes.shape_columns import shape_columns, shape_places
from dynident.identification.shapes.shape_constants import looked_at_shapes, shape_constants
from dynident.identification.shapes.shapes import check_shapes_given, complete_shapes
from dynident.identification.strategies.by_name import fit
from dynident.identification.study.carrying import carrying, is_open, note_of
from dynident.identification.study.gain import warnings_of_addition
from dynident.identification.study.preparing import prepared
from dynident.identification.study.result import Identification
from dynident.identification.study.warnings import warnings_of
from dynident.progress import Progress, part, silent
from dynident.recordings import Preprocessing, Recording, choose_preprocessing
from dynident.regressors.extension import extended_model
from dynident.regressors.model import Model, build_model
from dynident.regressors.rows import KeptRows, reduce_with_more
from dynident.robot.model import Robot
from dynident.threads import single_threaded


@single_threaded
def identify(
    robot: Robot,
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    choices: IdentificationChoices | None = None,
    progress: Progress = silent,
) -> Identification:
    """Identify the base parameters of a robot from recordings.

    Parameters
    ----------
    robot : Robot
    recordings : sequence of Recording
        The data that parameters are fitted to; those with the role "friction" are tests of single joints, which the
        strategy separate_friction alone uses.
    validation : sequence of Recording
        Data that no parameter sees; the held-out errors come from them.
    choices : IdentificationChoices, optional

    Raises
    ------
    DynidentError
        Where the choices do not fit the robot or the data do not determine the parameters.
    """
    choices = choices or IdentificationChoices()
    check_recordings(robot, recordings, validation)
    check_temperature(choices.effects, recordings, validation)
    check_runs(choices.effects, recordings, validation)
    ordinary, _ = motions_and_friction(recordings)
    preprocessing = choices.preprocessing or choose_preprocessing(ordinary)
    rows, preprocessing = with_constants(choices.rows_asked, ordinary, preprocessing)
    check_shapes_given(choices.effects)
    effects, reference = prepared(
        robot,
        choices.effects,
        choices.trust,
        ordinary,
        preprocessing,
        part(progress, 0.0, 0.5),
        tolerance=choices.tolerance,
    )
    choices = replace(choices, effects=effects, pole=rows.pole, interval=rows.interval)
    model = build_model(robot, choices.effects, tolerance=choices.tolerance)
    return identify_model(model, recordings, validation, choices, preprocessing, reference, part(progress, 0.5, 1.0))


@single_threaded
def extend(
    identification: Identification,
    added: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    progress: Progress = silent,
) -> Identification:
    """Add effects to an identified model, one rung of the ladder each, on the data it was identified from.

    The last rung is given; those below it are its parents. An effect that adds nothing to those before it gets none.

    Raises
    ------
    DynidentError
        Where nothing would be added.
    """
    new = tuple(choice for choice in added if choice not in identification.choices.effects)
    if not new:
        raise DynidentError("all of these effects are in the model already", pointer="/effects", title="Nothing to add")
    check_shapes_given(new)
    check_recordings(identification.model.robot, recordings, validation)
    check_temperature(new, recordings, validation)
    check_runs(new, recordings, validation)
    grown, idle = identification, []
    for number, choice in enumerate(new):
        told = part(progress, number / len(new), (number + 1) / len(new))
        found = _with_one_more(grown, choice, recordings, validation, told)
        if found is None:
            idle.append(choice.effect)
        else:
            grown = found
    if grown is identification:
        raise DynidentError(
            f"{', '.join(idle)} adds nothing: its columns are combinations of those in the model",
            pointer="/effects",
            title="Nothing to add",
        )
    if not idle:
        return grown
    left_out = f"{', '.join(idle)} added nothing beside the others and was left out."
    return replace(grown, warnings=(*grown.warnings, left_out))


def extend_at_once(
    identification: Identification,
    added: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    progress: Progress = silent,
) -> Identification:
    """The model with several effects, whose shape constants are known, as one rung: without those between.

    Raises
    ------
    DynidentError
        Where they add nothing, or not all of it is determined.
    """
    grown = _identified_with(identification, tuple(added), recordings, (), progress)
    if grown is None:
        raise DynidentError("the columns of these effects are combinations of those in the model", pointer="/effects")
    return grown


def _with_one_more(
    identification: Identification,
    added: EffectChoice,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> Identification | None:
    """The model with one more effect in it; None where its columns are combinations of those that it has."""
    new = complete_shapes(
        identification.model,
        (added,),
        motions_and_friction(recordings)[0],
        identification.preprocessing,
        identification.next_reference(),
        part(progress, 0.0, 0.5),
        identification.rows[0],
    )
    looked_for = any(is_open(choice, validation) for choice in new)
    told = part(progress, 0.5, 0.75 if looked_for else 1.0)
    grown = _identified_with(identification, new, recordings, validation, told)
    if grown is None or not looked_for:
        return grown
    found = carrying(grown, identification.model, new, validation)
    if not found:
        return grown
    more = tuple(one.run for one in found)
    carried = tuple(replace(choice, runs=choice.runs + more) if choice.runs else choice for choice in new)
    grown = _identified_with(identification, carried, recordings, validation, part(progress, 0.75, 1.0))
    return grown and replace(grown, warnings=(note_of(new, found), *grown.warnings))


def _identified_with(
    identification: Identification,
    new: tuple[EffectChoice, ...],
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> Identification | None:
    choices = replace(identification.choices, effects=identification.choices.effects + new)
    model = extended_model(identification.model, new, tolerance=choices.tolerance)
    if model.n_parameters == identification.model.n_parameters:
        return None
    reference = identification.reference
    if model.needs_load:
        reference = identification.next_reference()
    # The plain model's parameters made up for what was missing; columns of the predicted torque, and of the load that
    # others change, are better about the new ones.
    again = any(effect_by_id(choice.effect).first_order for choice in new) or (len(new) > 1 and model.needs_load)
    passes = 2 if again else 1
    for number in range(passes):
        grown = identify_model(
            model,
            recordings,
            validation,
            choices,
            identification.preprocessing,
            reference,
            part(progress, number / passes, (number + 1) / passes),
            identification.rows,
        )
        reference = grown.next_reference()
    grown = replace(grown, parent=identification, added=new)
    return replace(grown, warnings=warnings_of_addition(grown) + grown.warnings)


def identify_model(
    model: Model,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    choices: IdentificationChoices,
    preprocessing: Preprocessing,
    reference: FloatArray,
    progress: Progress,
    known: tuple[KeptRows | None, KeptRows | None] = (None, None),
) -> Identification:
    """Identify the parameters of a model that is built already, with everything decided.

    Parameters
    ----------
    reference : (10 n,)
        Standard inertial parameters for load predictions; any where no effect needs the load.
    known : rows of the recordings and of the validation data, optional
        Of a model that this one extends.
    """
    share = 0.9 * len(recordings) / (len(recordings) + len(validation))
    training = reduced(
        model, choices.rows_asked, recordings, preprocessing, reference, part(progress, 0.0, share), known[0]
    )
    held_out = None
    if validation:
        held_out = torque_of(model, validation, preprocessing, reference, part(progress, share, 0.9), known[1])
    progress(0.9, "solving")
    told = part(progress, 0.9, 1.0)

    def shaped(values: FloatArray) -> Reduction | None:
        places = shape_places(model.effects)
        if not places:
            return None
        columns = shape_columns(model, values, places)
        ordinary = training.recordings
        return reduce_with_more(model, columns, ordinary, preprocessing, reference, told, training.rows)

    found = conclude(model, choices, training, None if held_out is None else held_out.torque, shaped=shaped)
    names = tuple(recording.name for recording in recordings), tuple(recording.name for recording in validation)
    rows = training.rows, None if held_out is None else held_out.rows
    return replace(found, measurement_names=names[0], validation_names=names[1], rows=rows)


@dataclass(frozen=True, eq=False)
class Part:
    """A model is a part of a larger one, `whole`: its columns are the whole's times `weights` (b, b')."""

    whole: Model
    weights: FloatArray


def conclude(
    model: Model,
    choices: IdentificationChoices,
    data: Data,
    held_out_data: Reduction | None,
    part_of: Part | None = None,
    shaped: Callable[[FloatArray], Reduction | None] | None = None,
) -> Identification:
    """Solve, judge and describe a model on reduced data.

    Parameters
    ----------
    part_of : Part, optional
        A larger model: what is compiled for that one serves.
    shaped : function, optional
        Gives the joints' torques in the model's columns and, behind them, those of `shape_columns` at parameters (b,).
    """
    problem = Problem.of(model, choices, data)
    check_reduction(model, data.equations, problem.known)
    if choices.model != "base_wrench":
        check_torque(model, data.torque)
    found = fit(choices, problem)
    values = found.solution.values
    with_shapes = None if shaped is None else shaped(values)
    looked = None if with_shapes is None else _with_shapes_uncertain(problem, found, with_shapes)
    if part_of is None:
        smallest = smallest_inertia_eigenvalue(model, values)
    else:
        smallest = smallest_inertia_eigenvalue(part_of.whole, part_of.weights @ values)
    certain = not choices.least_squares_of_torque
    result = Identification(
        model=model,
        choices=choices,
        preprocessing=data.preprocessing,
        reference=data.reference,
        equations=data.equations,
        training=data.torque,
        held_out_data=held_out_data,
        solution=found.solution,
        statistics=found.statistics if certain or looked is None else looked.of_parameters,
        fit=errors(data.torque, values),
        held_out=errors(held_out_data, values) if held_out_data is not None else None,
        condition_number=condition_number(data.equations),
        inertia_matrix_positive_definite=bool(smallest > 0),
        worst_inertia_eigenvalue=smallest,
        warnings=(),
        measurement_names=(),
        validation_names=(),
        standard=found.standard,
        shape_constants=shape_constants(model, looked),
        shaped=with_shapes,
    )
    return replace(result, warnings=found.warnings + warnings_of(result))


def _with_shapes_uncertain(problem: Problem, found: Fit, with_shapes: Reduction) -> Linearised | None:
    """What the joints' torques say of the shape constants, whatever rows the parameters were solved from."""
    data, solution = problem.data, found.solution
    if data.equations is not data.torque:
        solution = replace(solution, noise=noise_levels(data.torque, solution.values))
    return looked_at_shapes(problem.model, solution, problem.covariance, with_shapes)
