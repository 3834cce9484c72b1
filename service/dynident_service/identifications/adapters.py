"""Choices of an identification from bodies; views and tables of models and verdicts; exported files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.errors import DynidentError
from dynident.export import ExportedFile, ExportFormat, export_model, model_to_document
from dynident.identification import Identification, IdentificationChoices, IdentifiedParameter
from dynident.identification.equations.reduced_recordings import split_friction_tests
from dynident.identification.identified_models.correlated_and_essential_parameters import (
    EssentialPath,
    parameter_dependence,
)
from dynident.identification.identified_models.held_out_gain import list_confirming_rows
from dynident.identification.shape_constant_intervals import ShapeConstant
from dynident.identification.shape_search import check_choices
from dynident.presentation.labels import CONDITION_MEANING
from dynident.presentation.model_tables import (
    ErrorKind,
    build_error_table,
    build_essential_tables,
    build_parameter_table,
    build_quality_table,
    build_shape_table,
)
from dynident.presentation.tables import ReportedTable
from dynident.presentation.validation_and_verdict_tables import build_verdict_tables
from dynident.recordings import Preprocessing, Recording, preprocessing_from_request
from dynident.recordings.metadata_revisions import adapt_revision
from dynident.robot import Robot
from dynident.verdict import ModelVerdict, Stop
from dynident_service.identifications import verdict_wire_types as verdict_wire
from dynident_service.identifications import wire_types as wire
from dynident_service.identifications.ladders import select_judged, show_fit
from dynident_service.measurements.adapters import show_revision, to_recording_metadata
from dynident_service.measurements.wire_types import MeasurementMetadata
from dynident_service.shared.field_by_field import (
    from_view,
    show_tables,
    to_request,
    to_view,
)

if TYPE_CHECKING:
    from fastapi import Response


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


def build_identification_tables(
    result: wire.IdentificationResult, floor: Sequence[float | None] | None = None
) -> Iterator[ReportedTable]:
    """Yield the tables of parameters, shape constants, quality, and errors (with the noise floor where it is known)."""
    kinds = [
        ErrorKind(name, errors.moving or errors, errors)
        for name, errors in (("fit", result.residual), ("held out", result.validation))
        if errors is not None
    ]
    yield build_parameter_table("Base parameters", [_restore_parameter(parameter) for parameter in result.parameters])
    if result.shape_constants:
        yield build_shape_table(
            [from_view(ShapeConstant, constant) for constant in result.shape_constants], result.joints
        )
    yield build_quality_table(
        select_judged(result.residual).relative_total,
        None if result.validation is None else select_judged(result.validation).relative_total,
        [parameter.well_identified for parameter in result.parameters],
        result.equilibrated_condition_number or result.condition_number,
        result.n_equations,
        result.equations_per_parameter,
    )
    yield build_error_table(kinds, result.joints, result.effort_units, floor)


def _restore_parameter(parameter: wire.ParameterView) -> IdentifiedParameter:
    # Models that older versions stored have no judgement; it follows from what they have.
    judgement = parameter.judgement or ("determined" if parameter.well_identified else "uncertain")
    return from_view(IdentifiedParameter, parameter, judgement=judgement)


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
class OpenedMeasurement:
    """A stored recording that a model was identified from or held against."""

    id: str
    recording: Recording
    metadata: MeasurementMetadata


def show_verdict(verdict: ModelVerdict, measurements: Sequence[OpenedMeasurement] = ()) -> verdict_wire.VerdictView:
    """Build the view of a verdict.

    Parameters
    ----------
    verdict : ModelVerdict
        The verdict, which names recordings by name.
    measurements : sequence of OpenedMeasurement
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
    tables = show_tables(build_verdict_tables(verdict))
    return to_view(verdict_wire.VerdictView, verdict, stop=stop, common=common, tables=tables)


def _measurement_id(measurements: Mapping[str, OpenedMeasurement], name: str) -> str:
    return measurements[name].id if name in measurements else name


def _show_stop(stop: Stop, measurement: OpenedMeasurement | None) -> verdict_wire.StopView:
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
