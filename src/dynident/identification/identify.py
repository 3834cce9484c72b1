"""The global identification: one system of equations for all parameters (§12.3.3 i, §12.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.effects import EffectChoice, effect_by_id
from dynident.errors import DynidentError
from dynident.estimation import (
    EstimationError,
    Reduction,
    Solution,
    errors,
    ordinary,
    statistics,
    weighted,
)
from dynident.identification.choices import EstimatorName, IdentificationChoices
from dynident.identification.gain import warnings_of_addition
from dynident.identification.inertia import smallest_inertia_eigenvalue
from dynident.identification.result import Identification
from dynident.identification.shapes import check_shapes_given, complete_shapes, lacks_shape
from dynident.identification.warnings import unseen_parameters, warnings_of
from dynident.progress import Progress, part, silent
from dynident.recordings import Preprocessing, Recording, choose_preprocessing
from dynident.regressors.extension import extended_model
from dynident.regressors.model import Model, build_model
from dynident.regressors.rows import KeptRows, reduce_and_keep
from dynident.regressors.stream import reduce_recordings
from dynident.robot.model import FloatArray, Robot
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
        The data that parameters are fitted to.
    validation : sequence of Recording
        Data that no parameter sees; the held-out errors come from them.
    choices : IdentificationChoices, optional

    Raises
    ------
    DynidentError
        Where the choices do not fit the robot or the data do not determine the parameters.
    """
    choices = choices or IdentificationChoices()
    _check_recordings(robot, recordings, validation)
    _check_temperature(choices.effects, recordings, validation)
    _check_runs(choices.effects, recordings)
    preprocessing = choices.preprocessing or choose_preprocessing(recordings)
    check_shapes_given(choices.effects)
    choices, reference = _prepared(robot, recordings, preprocessing, choices, part(progress, 0.0, 0.5))
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
    """Add effects to an identified model and solve again, on the data it was identified from.

    Raises
    ------
    DynidentError
        Where nothing would be added.
    """
    new = tuple(choice for choice in added if choice not in identification.choices.effects)
    if not new:
        raise DynidentError("all of these effects are in the model already", pointer="/effects", title="Nothing to add")
    check_shapes_given(new)
    _check_recordings(identification.model.robot, recordings, validation)
    _check_temperature(new, recordings, validation)
    _check_runs(new, recordings)
    new = complete_shapes(
        identification.model,
        new,
        recordings,
        identification.preprocessing,
        identification.next_reference(),
        part(progress, 0.0, 0.5),
    )
    choices = replace(identification.choices, effects=identification.choices.effects + new)
    model = extended_model(identification.model, new, tolerance=choices.tolerance)
    if model.n_parameters == identification.model.n_parameters:
        raise DynidentError(
            f"{', '.join(choice.effect for choice in new)} adds nothing: its columns are combinations of those in the "
            "model",
            pointer="/effects",
            title="Nothing to add",
        )
    reference = identification.reference
    if model.needs_load:
        reference = identification.next_reference()
    # The plain model's parameters made up for what was missing; first-order columns are better about the new ones.
    passes = 2 if any(effect_by_id(choice.effect).first_order for choice in new) else 1
    for number in range(passes):
        grown = identify_model(
            model,
            recordings,
            validation,
            choices,
            identification.preprocessing,
            reference,
            part(progress, 0.5 + 0.5 * number / passes, 0.5 + 0.5 * (number + 1) / passes),
            identification.rows,
        )
        reference = grown.next_reference()
    grown = replace(grown, parent=identification, added=new)
    return replace(grown, warnings=warnings_of_addition(grown) + grown.warnings)


def solve_reduced(reduction: Reduction, estimator: EstimatorName) -> Solution:
    """Solve with the named estimator."""
    return ordinary(reduction) if estimator == "ols" else weighted(reduction)


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
    training, rows = reduce_and_keep(model, recordings, preprocessing, reference, part(progress, 0.0, share), known[0])
    held_out_data, held_out_rows = None, None
    if validation:
        held_out_data, held_out_rows = reduce_and_keep(
            model, validation, preprocessing, reference, part(progress, share, 0.9), known[1]
        )
    progress(0.9, "solving")
    found = conclude(model, choices, preprocessing, reference, training, held_out_data, recordings, validation)
    return replace(found, rows=(rows, held_out_rows))


def conclude(
    model: Model,
    choices: IdentificationChoices,
    preprocessing: Preprocessing,
    reference: FloatArray,
    training: Reduction,
    held_out_data: Reduction | None,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
) -> Identification:
    """Solve, judge and describe a model on reduced data."""
    _check_reduction(model, training)
    solution = solve_reduced(training, choices.estimator)
    found = statistics(training, solution)
    plain = ordinary(training).condition_number
    smallest = smallest_inertia_eigenvalue(model, solution.values)
    result = Identification(
        model=model,
        choices=choices,
        preprocessing=preprocessing,
        reference=reference,
        training=training,
        held_out_data=held_out_data,
        solution=solution,
        statistics=found,
        fit=errors(training, solution.values),
        held_out=errors(held_out_data, solution.values) if held_out_data is not None else None,
        condition_number=plain,
        inertia_matrix_positive_definite=bool(smallest > 0),
        worst_inertia_eigenvalue=smallest,
        warnings=(),
        measurement_names=tuple(recording.name for recording in recordings),
        validation_names=tuple(recording.name for recording in validation),
    )
    return replace(result, warnings=warnings_of(result))


def _prepared(
    robot: Robot,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    choices: IdentificationChoices,
    progress: Progress,
) -> tuple[IdentificationChoices, FloatArray]:
    """The choices with every shape constant found, and the standard inertial parameters for load predictions.

    Both come from a first fit without the effects that need them.
    """
    plain = tuple(c for c in choices.effects if not effect_by_id(c.effect).needs_load and not lacks_shape(c))
    if len(plain) == len(choices.effects):
        return choices, np.zeros(10 * robot.n)
    if not any(choice.effect == "rigid_body" for choice in plain):
        raise DynidentError(
            "effects that depend on the load or whose shape is to be found need rigid_body beside them",
            pointer="/effects",
        )
    first = build_model(robot, plain, tolerance=choices.tolerance)
    zeros = np.zeros(10 * robot.n)
    reduction = reduce_recordings(first.observation, recordings, preprocessing, zeros, part(progress, 0.0, 0.5))
    _check_reduction(first, reduction)
    reference = first.reference(solve_reduced(reduction, choices.estimator).values)
    others = tuple(choice for choice in choices.effects if choice not in plain)
    found = complete_shapes(first, others, recordings, preprocessing, reference, part(progress, 0.5, 1.0))
    return replace(choices, effects=plain + found), reference


def _check_recordings(robot: Robot, recordings: Sequence[Recording], validation: Sequence[Recording]) -> None:
    if not recordings:
        raise DynidentError("give at least one measurement to identify from", pointer="/measurement_ids")
    for pointer, group in (("/measurement_ids", recordings), ("/validation_ids", validation)):
        for index, recording in enumerate(group):
            if recording.joint_names != robot.joint_names:
                raise DynidentError(
                    f"{recording.name} has the joints {', '.join(recording.joint_names)}; the robot has "
                    f"{', '.join(robot.joint_names)}",
                    pointer=f"{pointer}/{index}",
                    title="Another robot's measurement",
                )


def _check_temperature(
    effects: Sequence[EffectChoice], recordings: Sequence[Recording], validation: Sequence[Recording]
) -> None:
    """Raise where an effect needs the joints' temperature and a recording has none: a guess would pass for data."""
    for index, choice in enumerate(effects):
        if not effect_by_id(choice.effect, f"/effects/{index}").needs_temperature:
            continue
        cold = [recording.name for recording in (*recordings, *validation) if not recording.has_temperature]
        if cold:
            raise DynidentError(
                f"{choice.effect} needs the temperature of every joint; {', '.join(cold)} has no columns temperature1, "
                f"temperature2, …. Record them, or choose warm_up_friction, which needs the time of the session alone",
                pointer=f"/effects/{index}",
                title="Temperature needed",
            )


def _check_runs(effects: Sequence[EffectChoice], recordings: Sequence[Recording]) -> None:
    """Raise where an effect is limited to runs that there are not, or needs to be limited and is not."""
    labels = dict.fromkeys(label for recording in recordings for label in recording.run_labels)
    known = {*labels, *(recording.name for recording in recordings)}
    for index, choice in enumerate(effects):
        strangers = [run for run in choice.runs if run not in known]
        if strangers:
            raise DynidentError(
                f"{choice.effect} is said to be in {', '.join(strangers)}; the runs are: {', '.join(labels)}",
                pointer=f"/effects/{index}/runs",
                title="Unknown run",
            )
        stated = any(recording.payload is not None for recording in recordings)
        if effect_by_id(choice.effect, f"/effects/{index}").in_some_runs and not choice.runs and not stated:
            raise DynidentError(
                f"{choice.effect} has to be in some of the runs: name them (runs), out of {', '.join(labels)}, or "
                "state the payload in the metadata of the measurements that have one",
                pointer=f"/effects/{index}/runs",
                title="Runs needed",
            )


def _check_reduction(model: Model, reduction: Reduction) -> None:
    """Raise where the data cannot determine the model, naming what is missing."""
    if reduction.n_rows == 0:
        raise EstimationError(
            "no rows are left after filtering; use a longer recording or wider windows",
            pointer="/measurement_ids",
            title="Too few samples",
        )
    unseen = unseen_parameters(model, reduction)
    if unseen:
        raise EstimationError(
            f"not identifiable from this data: {', '.join(unseen)} (a joint that does not move enough leaves its "
            "parameters undetermined); lock that joint, leave its effects out, or record a motion of it",
            pointer="/measurement_ids",
            title="Not identifiable",
        )
