"""Choices of an identification from bodies; views and tables of models, ladders and verdicts; exported files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from dynident.errors import DynidentError
from dynident.export import ExportedFile, ExportFormat, export_model, model_to_document
from dynident.identification import Identification, IdentificationChoices, IdentifiedParameter
from dynident.identification.equations.reduced_recordings import split_friction_tests
from dynident.identification.identified_models.correlated_and_essential_parameters import (
    EssentialPath,
    parameter_dependence,
)
from dynident.identification.identified_models.held_out_gain import find_best_of_errors, list_confirming_rows
from dynident.identification.shape_constant_intervals import ShapeConstant
from dynident.identification.shape_search import check_choices
from dynident.recordings import Preprocessing, Recording, preprocessing_from_request
from dynident.recordings.metadata_revisions import adapt_revision
from dynident.reports.labels import CONDITION_MEANING
from dynident.reports.result_tables import build_essential_tables, build_parameter_table, build_shape_table
from dynident.reports.table_cells import ReportedTable
from dynident.robot import Robot
from dynident.verdict import ModelVerdict, Stop
from dynident_service.adapters.field_by_field import from_view, show_errors, show_tables, to_request, to_view
from dynident_service.adapters.measurements import show_revision, to_recording_metadata
from dynident_service.wire_types import identifications as wire
from dynident_service.wire_types import verdicts as verdict_wire
from dynident_service.wire_types.identifications import (
    ErrorFigures,
    ErrorsView,
    IdentificationView,
    LadderStep,
    LadderStepDifference,
    Lineage,
)
from dynident_service.wire_types.measurements import MeasurementMetadata
from dynident_service.wire_types.shared_types import EffectChoice

if TYPE_CHECKING:
    from fastapi import Response

T = TypeVar("T", int, float)


def build_steps_of_views(views: Sequence[IdentificationView]) -> list[LadderStep]:
    """Build the steps of a ladder of stored models, the first one first, with the intermediate ones of extensions."""
    steps: list[LadderStep] = []
    for view in views:
        # An extension by several effects has made models on its way, which are steps as well.
        steps += _build_intermediate_steps(view, steps[-1] if steps else None)
        steps.append(_build_own_step(view, steps[-1] if steps else None))
    return mark_best_step(steps)


def mark_best_step(steps: Sequence[LadderStep]) -> list[LadderStep]:
    """Return a ladder with its best step marked, and the later steps that increase the validation error."""
    totals = [_select_judged_total(step.validation) for step in steps]
    known_totals = [total for total in totals if total is not None]
    preferred = [bool(step.confirmed_by or step.removed) for step in steps]
    # Only where every step has a validation error: a step without one could be the best.
    marks = find_best_of_errors(known_totals, preferred) if len(known_totals) == len(steps) else None
    if marks is None:
        return list(steps)
    return [
        step.model_copy(update={"best": k == marks.best, "rises": k in marks.rises}) for k, step in enumerate(steps)
    ]


def _select_judged_total(errors: ErrorsView | None) -> float | None:
    """Return the error that models are compared by: of moving rows; where none are known, of all rows."""
    if errors is None:
        return None
    moving = None if errors.moving is None else errors.moving.relative_total
    return errors.relative_total if moving is None else moving


def _build_intermediate_steps(view: IdentificationView, below: LadderStep | None) -> list[LadderStep]:
    """Build the steps between a model and its parent; an extension by several effects has one for each."""
    steps: list[LadderStep] = []
    for number, step in enumerate(view.result.rungs if view.result is not None else [], start=1):
        under = steps[-1] if steps else below
        ladder_step = LadderStep(
            id=f"{view.id}/{number}",
            part_of=view.id,
            name=view.name,
            parent_id=None if under is None else under.id,
            status=view.status,
            added=step.added,
            removed=[],
            effects=[*([] if under is None else under.effects), *step.added],
            n_parameters=step.n_parameters,
            residual=step.residual,
            validation=step.validation,
            confirmed_by=step.confirmed_by,
        )
        steps.append(ladder_step)
    return steps


def _build_own_step(view: IdentificationView, below: LadderStep | None) -> LadderStep:
    result = view.result
    effects = view.request.effects if result is None else result.effects
    return LadderStep(
        id=view.id,
        name=view.name,
        parent_id=view.parent_id if below is None else below.id,
        status=view.status,
        added=_last_added(view, effects, below),
        removed=view.removed,
        effects=effects,
        n_parameters=None if result is None else len(result.parameters),
        residual=None if result is None else result.residual,
        validation=None if result is None else result.validation,
        confirmed_by=None if result is None else result.confirmed_by,
    )


def _last_added(view: IdentificationView, effects: list[EffectChoice], below: LadderStep | None) -> list[EffectChoice]:
    """Return what the last step added, with the shape constants that were found."""
    # The steps below have the first of the requested effects; the rest of the list is new at this step.
    if not view.added or view.result is None or below is None:
        return view.added
    return effects[len(below.effects) :]


def compare_ladders(own: Sequence[LadderStep], other: Sequence[LadderStep], same_data: bool) -> Lineage:
    """Compare two ladders.

    Parameters
    ----------
    own, other : sequence of LadderStep
        The ladders, their first models first.
    same_data : bool
        Whether all their models rest on the same recordings.

    Returns
    -------
    Lineage
        Both ladders, their last common model, and the differences of errors step by step.
    """
    # Ladders of one robot may begin with the same models: the last pair of equal ids is where they part.
    shared = [a.id for a, b in zip(own, other, strict=False) if a.id == b.id]
    return Lineage(
        items=list(own),
        against=list(other),
        common_ancestor=shared[-1] if shared else None,
        differences=[_show_difference(k, a, b) for k, (a, b) in enumerate(zip_longest(own, other), start=1)],
        same_data=same_data,
    )


def _show_difference(number: int, own: LadderStep | None, other: LadderStep | None) -> LadderStepDifference:
    fit = (own.residual if own else None, other.residual if other else None)
    held_out = (own.validation if own else None, other.validation if other else None)
    counts = (own.n_parameters if own else None, other.n_parameters if other else None)
    return LadderStepDifference(
        rung=number,
        id=own.id if own else None,
        against_id=other.id if other else None,
        n_parameters=_subtract(*counts),
        residual=_subtract_per_joint(*fit),
        residual_total=_subtract_totals(*fit),
        validation=_subtract_per_joint(*held_out),
        validation_total=_subtract_totals(*held_out),
        residual_moving=_subtract_per_joint(*map(_get_moving, fit)),
        residual_moving_total=_subtract_totals(*map(_get_moving, fit)),
        validation_moving=_subtract_per_joint(*map(_get_moving, held_out)),
        validation_moving_total=_subtract_totals(*map(_get_moving, held_out)),
    )


def _get_moving(errors: ErrorsView | None) -> ErrorFigures | None:
    return None if errors is None else errors.moving


def _subtract_per_joint(own: ErrorFigures | None, other: ErrorFigures | None) -> list[float | None] | None:
    if own is None or other is None:
        return None
    return [_subtract(a, b) for a, b in zip(own.relative, other.relative, strict=True)]


def _subtract_totals(own: ErrorFigures | None, other: ErrorFigures | None) -> float | None:
    return None if own is None or other is None else _subtract(own.relative_total, other.relative_total)


def _subtract(a: T | None, b: T | None) -> T | None:
    return None if a is None or b is None else a - b


def build_steps(
    identification: Identification, name: str, other_ladder: tuple[Identification, str] | None = None
) -> list[LadderStep]:
    """Build the steps of a ladder from a model in a file.

    Parameters
    ----------
    identification : Identification
        The last model of the ladder.
    name : str
        Its name; the models before it are called name/1, name/2, ….
    other_ladder : tuple of Identification and str, optional
        Another ladder and its name. Steps at which both have the same model take the other ladder's ids, so that
        `compare_ladders` sees what they share.

    Returns
    -------
    list of LadderStep
        The steps, the first model first.
    """
    models = list(identification.ladder())
    ids = _step_ids(name, len(models))
    if other_ladder is not None:
        others = list(other_ladder[0].ladder())
        for k, (model, other) in enumerate(zip(models, others, strict=False)):
            # Models in files have no ids: they are the same if their choices and all their values are.
            if model.choices != other.choices or not np.array_equal(model.values, other.values):
                break
            ids[k] = _step_ids(other_ladder[1], len(others))[k]
    steps = [
        to_view(
            LadderStep,
            model,
            id=identifier,
            name=identifier,
            parent_id=ids[k - 1] if k else None,
            status="succeeded",
            residual=show_fit(model),
            confirmed_by=list_confirming_rows(model),
        )
        for k, (identifier, model) in enumerate(zip(ids, models, strict=True))
    ]
    return mark_best_step(steps)


def _step_ids(name: str, count: int) -> list[str]:
    return [*(f"{name}/{k}" for k in range(1, count)), name]


def to_choices(
    request: wire.IdentificationRequest, robot: Robot, recordings: Sequence[Recording] = ()
) -> IdentificationChoices:
    """Build the choices of an identification from a body.

    Parameters
    ----------
    request : IdentificationRequest
        The body.
    robot : Robot
        The robot.
    recordings : sequence of Recording
        Recordings that the filters are chosen from. Without them, the filters are left to the identification.

    Returns
    -------
    IdentificationChoices
        The choices.

    Raises
    ------
    DynidentError
        Where a choice does not exist, is not available, or does not fit the robot.
    """
    filters = _choose_preprocessing(request, recordings) if recordings else None
    choices = to_request(request, IdentificationChoices, preprocessing=filters)
    check_choices(choices.effects, robot)
    return choices


def describe_identification(
    identification: Identification, parent_id: str | None, parent: Identification | None = None
) -> wire.IdentificationResult:
    """Build the view of an identified model.

    Parameters
    ----------
    identification : Identification
        The model.
    parent_id : str, optional
        Id of the model that it was made from.
    parent : Identification, optional
        That model; with it the view has the steps between the two.

    Returns
    -------
    IdentificationResult
        The view.
    """
    return to_view(
        wire.IdentificationResult,
        identification,
        residual=show_fit(identification),
        confirmed_by=list_confirming_rows(identification),
        dependence=parameter_dependence(identification).sentences,
        condition_meaning=CONDITION_MEANING,
        parent_id=parent_id,
        rungs=[] if parent is None else [_show_step(step) for step in _list_steps_between(parent, identification)],
        effort_units=[joint.effort_unit for joint in identification.model.robot.joints],
    )


def describe_essential(path: EssentialPath) -> wire.EssentialView:
    """Build the view of a backward elimination with the essential parameters."""
    essential_parameters = [parameter for parameter in path.identification.parameters if parameter.essential]
    return to_view(
        wire.EssentialView, path, parameters=essential_parameters, tables=show_tables(build_essential_tables(path))
    )


def build_identification_tables(result: wire.IdentificationResult) -> Iterator[ReportedTable]:
    """Yield the tables of parameters and of shape constants of a stored result."""
    yield build_parameter_table("Base parameters", [_restore_parameter(parameter) for parameter in result.parameters])
    if result.shape_constants:
        yield build_shape_table(
            [from_view(ShapeConstant, constant) for constant in result.shape_constants], result.joints
        )


def _restore_parameter(parameter: wire.ParameterView) -> IdentifiedParameter:
    # Models that older versions stored have no judgement; it follows from what they have.
    judgement = parameter.judgement or ("determined" if parameter.well_identified else "uncertain")
    return from_view(IdentifiedParameter, parameter, judgement=judgement)


def show_fit(identification: Identification) -> wire.ErrorsView:
    """Build the view of the errors on the data that a model was identified from."""
    return show_errors(identification.fit, identification.fit_moving, identification.noise)


def _list_steps_between(parent: Identification, identification: Identification) -> list[Identification]:
    """Return the models between `parent` and `identification`, both excluded, in the order they were made."""
    between: list[Identification] = []
    ancestor = identification.step.parent
    while ancestor is not None and ancestor is not parent:
        between.insert(0, ancestor)
        ancestor = ancestor.step.parent
    return between


def _show_step(identification: Identification) -> wire.StepView:
    return to_view(
        wire.StepView,
        identification,
        residual=show_fit(identification),
        confirmed_by=list_confirming_rows(identification),
    )


def _choose_preprocessing(request: wire.IdentificationRequest, recordings: Sequence[Recording]) -> Preprocessing | None:
    """Return the filters that a body states; None where all of them are chosen by the identification."""
    stated_filters = request.preprocessing
    filter_values = {} if isinstance(stated_filters, str) else stated_filters.model_dump()
    # The identification chooses the filters of its own data, and then also says why.
    if all(value == "auto" for value in filter_values.values()):
        return None
    # Tests of friction at constant velocity say nothing about the bandwidth of the motion.
    motions, _ = split_friction_tests(recordings)
    return preprocessing_from_request(filter_values, motions)


@dataclass(frozen=True, eq=False)
class SeenMeasurement:
    """A stored recording that a model was identified from or held against."""

    id: str
    recording: Recording
    metadata: MeasurementMetadata


def show_verdict(verdict: ModelVerdict, measurements: Sequence[SeenMeasurement] = ()) -> verdict_wire.VerdictView:
    """Build the view of a verdict.

    Parameters
    ----------
    verdict : ModelVerdict
        The verdict, which names recordings by name.
    measurements : sequence of SeenMeasurement
        Stored recordings; those among them are named by id in the view.

    Returns
    -------
    VerdictView
        The view.
    """
    by_name = {measurement.recording.name: measurement for measurement in measurements}
    stop = None if verdict.stop is None else _show_stop(verdict.stop, by_name.get(verdict.stop.recording or ""))
    common = [
        to_view(
            verdict_wire.CommonView,
            overlap,
            held_out_id=_measurement_id(by_name, overlap.held_out),
            fitted_id=_measurement_id(by_name, overlap.fitted),
            detail=str(overlap),
        )
        for overlap in verdict.common
    ]
    return to_view(verdict_wire.VerdictView, verdict, stop=stop, common=common)


def _measurement_id(measurements: Mapping[str, SeenMeasurement], name: str) -> str:
    return measurements[name].id if name in measurements else name


def _show_stop(stop: Stop, measurement: SeenMeasurement | None) -> verdict_wire.StopView:
    cure = stop.apply
    if cure is not None and measurement is not None:
        # The cure refers to the recording as it was read. The revision has to change what was stated about the file.
        cure = adapt_revision(cure, to_recording_metadata(measurement.metadata), measurement.recording.joint_names)
    return verdict_wire.StopView(
        cause=stop.cause,
        measurement_id=stop.recording if measurement is None else measurement.id,
        apply=None if cure is None else show_revision(cure),
    )


NOTES_HEADER = "Dynident-Notes"
# Many proxies refuse headers above 4 or 8 kB in total. The file itself has all notes.
_LONGEST = 3000


def export_file(model: Identification, format: ExportFormat, nearest: bool, shown: dict[str, object]) -> ExportedFile:
    """Export a model.

    Parameters
    ----------
    model : Identification
        The model.
    format : str
        The format; "json" includes what the service shows of the model.
    nearest : bool
        Whether to export the nearest physically feasible parameters where the format needs feasible ones.
    shown : dict
        What the service shows of the model.

    Returns
    -------
    ExportedFile
        The file, with notes on what the format cannot hold.

    Raises
    ------
    DynidentError
        Where the format cannot hold the model; its pointer is the query's parameter.
    """
    try:
        file = export_model(model, format, nearest=nearest)
    except DynidentError as error:
        raise DynidentError(error.detail, pointer=error.pointer.removeprefix("/"), title=error.title) from error
    if format != "json":
        return file
    # What the service shows stands beside the model, so that `model_from_json` reads the file, too.
    content = json.dumps({**shown, "model": model_to_document(model)}, indent=1, allow_nan=False)
    return ExportedFile(file.name, file.media_type, content.encode(), file.notes)


def build_file_response(file: ExportedFile) -> Response:
    """Build the response with a file to be saved; its notes are a JSON list of sentences in a header."""
    # The command line uses this module, too, and should not load what only the service needs.
    from fastapi import Response

    headers = {"Content-Disposition": f'attachment; filename="{file.name}"'}
    if file.notes:
        headers[NOTES_HEADER] = _shorten_notes(file.notes)
    return Response(file.content, media_type=file.media_type, headers=headers)


def _shorten_notes(notes: Sequence[str]) -> str:
    """Return as many notes as a header may hold, as JSON in ASCII."""
    # Whole sentences: as many from the front as fit.
    for count in range(len(notes), 0, -1):
        shortened = list(notes[:count])
        if count < len(notes):
            shortened.append(f"{len(notes) - count} more in the file")
        if len(text := json.dumps(shortened)) <= _LONGEST:
            return text
    return json.dumps([f"{len(notes)} notes in the file"])
