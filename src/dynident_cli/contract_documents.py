"""Results as JSON with the fields of the HTTP contract, and files of such JSON read back (`--diagnosis`, `--limits`).

No other module of the commands of the library imports the views of the service. They are imported where a document is
asked for, as they take longer to load than a small robot to identify.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from dynident.errors import DynidentError
from dynident_cli.option_parsers import read_json_object, read_text

if TYPE_CHECKING:
    from pydantic import BaseModel, TypeAdapter

    from dynident.advice import AdvisedDiagnosis
    from dynident.api.model import Model
    from dynident.api.recording_collection import CheckedRecording
    from dynident.api.torque_comparison import ComparedRecording
    from dynident.diagnosis import Diagnosis
    from dynident.diagnosis.ambiguities import Doubt
    from dynident.diagnosis.monitoring import Series
    from dynident.excitation import Design
    from dynident.identification import CurrentModel
    from dynident.identification.column_inference import Inspection
    from dynident.identification.identified_models.correlated_and_essential_parameters import EssentialPath
    from dynident.identification.loads.drive_gains import DriveGains, PayloadEstimate
    from dynident.motion import Surroundings
    from dynident.recordings import RecordingMetadata
    from dynident.reports import ReportedValidation
    from dynident.robot import Limits, Robot
    from dynident.simulation import SimulatedRecording
    from dynident.validation.validation_request import Trial, TrialResult
    from dynident.verdict import ModelVerdict
    from dynident_service.validations.wire_types import ValidationResult

Document = Mapping[str, object]
View = TypeVar("View")


def to_document(view: BaseModel) -> Document:
    """Return a view as plain JSON."""
    from dynident_service.shared.wire_types import to_plain_json

    return to_plain_json(view)


def describe_catalogue() -> Document:
    """Describe the effects that a model can contain."""
    from dynident_service.shared.field_by_field import show_catalogue

    return to_document(show_catalogue())


def describe_model(
    model: Model,
    parent: tuple[str, Model] | None = None,
    verdict: ModelVerdict | None = None,
    recordings: Sequence[CheckedRecording] = (),
) -> Document:
    """Describe a model that was made from `parent`, with its verdict and the checks of its recordings where given."""
    from dynident_service.identifications.adapters import describe_identification, show_verdict
    from dynident_service.measurements.adapters import show_checks

    parent_id, ancestor = (None, None) if parent is None else (parent[0], parent[1].identification)
    document: dict[str, object] = {**to_document(describe_identification(model.identification, parent_id, ancestor))}
    if verdict is not None:
        document["verdict"] = to_document(show_verdict(verdict))
    if recordings:
        document["measurements"] = [
            {"name": item.name, "checks": [to_document(check) for check in show_checks(item.checks)]}
            for item in recordings
        ]
    return document


def describe_ladder(named: tuple[str, Model], against: tuple[str, Model] | None = None) -> Document:
    """Describe the steps that led to a model, given with its name, and those of another one."""
    from dynident_service.identifications.adapters import build_steps, compare_ladders
    from dynident_service.identifications.wire_types import Lineage

    name, model = named[0], named[1].identification
    own = build_steps(model, name)
    if against is None:
        return to_document(Lineage(items=own))
    other = against[1].identification
    data_sets = (step.data for top in (model, other) for step in top.ladder())
    data = {(data_set.measurement_names, data_set.validation_names) for data_set in data_sets}
    return to_document(compare_ladders(own, build_steps(other, against[0], (model, name)), len(data) == 1))


def describe_essential(path: EssentialPath) -> Document:
    """Describe the steps of a backward elimination."""
    from dynident_service.identifications.adapters import describe_essential as describe

    return to_document(describe(path))


def describe_currents(models: Sequence[CurrentModel]) -> Document:
    """Describe models of currents, one a joint."""
    from dynident_service.drive_gains.wire_types import CurrentModelsResult
    from dynident_service.shared.field_by_field import to_view

    return to_document(to_view(CurrentModelsResult, None, joints=models))


def describe_comparison(compared: ComparedRecording, *, fit: bool) -> Document:
    """Describe measured against predicted torque."""
    from dynident_service.comparisons.adapters import describe_comparison as describe

    return to_document(describe(compared.comparison, compared.judgement, True if fit else None))


def describe_diagnosis(diagnosis: Diagnosis, robot: Robot, doubts: Sequence[Doubt] = ()) -> Document:
    """Describe a diagnosis; `load_diagnosis` reads it back."""
    from dynident_service.diagnoses.adapters import describe_diagnosis as describe

    return to_document(describe(diagnosis, robot.name, doubts))


def load_diagnosis(path: Path) -> AdvisedDiagnosis:
    """Read a diagnosis that `dynident diagnose --out` wrote; `DynidentError` where the file holds none."""
    from pydantic import ValidationError

    from dynident_service.diagnoses.adapters import restore_diagnosis

    try:
        return restore_diagnosis(read_json_object(path))
    except ValidationError as error:
        first = error.errors()[0]
        raise DynidentError(
            f"{path.name} is not a diagnosis: {first['msg']} at {'/'.join(map(str, first['loc']))}", pointer=str(path)
        ) from error


def describe_series(series: Series) -> Document:
    """Describe what has changed over many days."""
    from dynident_service.diagnoses.adapters import describe_series as describe

    return to_document(describe(series))


def describe_design(design: Design) -> Document:
    """Describe a designed motion."""
    from dynident_service.designs.adapters import describe_design as describe

    return to_document(describe(design))


def describe_simulation(simulation: SimulatedRecording, rate: float) -> Document:
    """Describe a simulated recording of a rate in Hz."""
    from dynident_service.designs.adapters import describe_simulation as describe

    return to_document(describe(simulation, rate))


def describe_inspection(inspection: Inspection) -> Document:
    """Describe what the columns of a file probably are."""
    from dynident_service.measurements.adapters import describe_inspection as describe

    document: Document = describe(inspection, inspection.sha256).model_dump(mode="json")
    return document


def describe_error(error: DynidentError) -> Document:
    """Describe an error as the service does: a script need not know which of the two it talks to."""
    from dynident.recordings import RecordingError
    from dynident_service.measurements.adapters import describe_file_problem
    from dynident_service.problems import to_problem

    problem = describe_file_problem(error) if isinstance(error, RecordingError) else to_problem(error)
    document: Document = problem.model_dump(exclude_none=True)
    return document


def describe_validation(trial: Trial, outcome: TrialResult, names: Sequence[str]) -> ValidationResult:
    """Describe a test of a model on the recordings of these names, for `to_document` and its tables."""
    from dynident_service.validations.adapters import describe_validation as describe

    return describe(trial, outcome, names)


def describe_gains(robot: Robot, gains: DriveGains, loads: Sequence[tuple[str, PayloadEstimate]]) -> Document:
    """Describe drive gains, and the loads that were weighed by them, by name."""
    from dynident_service.drive_gains.jobs import describe_gains as describe

    return to_document(describe(robot, gains, [(name, name, load) for name, load in loads]))


def load_validation(path: Path) -> ValidationResult:
    """Read what `dynident validate --out` wrote; `DynidentError` where the file holds no validation."""
    from pydantic import ValidationError

    from dynident_service.validations.wire_types import ValidationResult

    try:
        return ValidationResult.model_validate_json(read_text(path))
    except ValidationError as error:
        detail = f"{path.name} does not contain a validation; give a file that `dynident validate --out` wrote"
        raise DynidentError(detail, pointer="--validated", title="Unusable file") from error


def load_reported_validation(path: Path, joint_names: Sequence[str]) -> ReportedValidation:
    """Read what `dynident validate --out` wrote, for a report."""
    from dynident_service.validations.adapters import build_reported_validation

    return build_reported_validation(load_validation(path), joint_names)


def parse_metadata(path: Path, values: Mapping[str, object]) -> RecordingMetadata:
    """Return metadata that a file states, after a check of their types and ranges."""
    from pydantic import ValidationError

    from dynident_service.measurements.adapters import to_recording_metadata
    from dynident_service.measurements.wire_types import MeasurementMetadata

    try:
        # A robot and a name are mandatory in the contract, but unused here.
        return to_recording_metadata(MeasurementMetadata.model_validate({"robot_id": "-", "name": "-", **values}))
    except ValidationError as error:
        first = error.errors()[0]
        place = "/".join(map(str, first["loc"]))
        raise DynidentError(f"{path.name}: {place}: {first['msg']}", pointer=str(path)) from error


def load_limits(path: Path | None) -> dict[str, Limits]:
    """Read limits by joint from a JSON file."""
    if path is None:
        return {}
    from pydantic import TypeAdapter

    from dynident.robot import Limits
    from dynident_service.robots.wire_types import Limits as WireLimits
    from dynident_service.shared.field_by_field import to_request

    limits_by_joint = _load_validated(TypeAdapter(dict[str, WireLimits]), path, "Unusable limits")
    return {name: to_request(value, Limits) for name, value in limits_by_joint.items()}


def load_surroundings(path: Path | None, mesh_folders: Sequence[Path], *, floor: bool) -> Surroundings:
    """Read the robot's surroundings from a JSON file; without one, nothing around the robot is stated.

    Collision meshes are searched for in the folders. `floor` tells whether to assume a floor where none is stated.
    """
    from pydantic import TypeAdapter

    from dynident.motion import Surroundings
    from dynident_service.shared.field_by_field import to_request
    from dynident_service.shared.request_bodies import find_body

    surroundings = Surroundings()
    if path is not None:
        fields: TypeAdapter[Any] = TypeAdapter(find_body(Surroundings))
        surroundings = to_request(_load_validated(fields, path, "Unusable surroundings"), Surroundings)
    # Folders are this machine's: a file of surroundings cannot know them.
    folders = tuple(str(folder) for folder in mesh_folders)
    return replace(surroundings, mesh_folders=folders, assume_floor=surroundings.assume_floor and floor)


def _load_validated(fields: TypeAdapter[View], path: Path, title: str) -> View:
    from pydantic import ValidationError

    from dynident_service.problems import to_problem_fields

    document = read_json_object(path)
    try:
        return fields.validate_python(document)
    except ValidationError as error:
        # The service words validation errors by the place in the body; here the body is the whole file.
        first = to_problem_fields([{**item, "loc": ("body", *item["loc"])} for item in error.errors()], document)[0]
        raise DynidentError(first.detail, pointer=f"{path}{first.pointer}", title=title) from error
