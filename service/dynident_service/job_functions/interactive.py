"""Short computations that a request waits for: verdict of a model, inspection, upload checks, raw signals, exports.

They run in a child process; values in and out are plain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from dynident.export import ExportedFile, ExportFormat
from dynident.identification import Identification, from_bytes
from dynident.identification.identified_models.correlated_and_essential_parameters import (
    essential_parameters,
    parameter_dependence,
)
from dynident.recordings import Check, RecordingError, open_recording
from dynident.recordings.recording_metadata import Status
from dynident.robot.collision_reader import list_collision_meshes
from dynident.validation import ValidationOutcome, Verdict
from dynident.verdict import Outcome, verdict
from dynident_service.adapters.designs import compute_clearances
from dynident_service.adapters.field_by_field import to_view
from dynident_service.adapters.identifications import SeenMeasurement, describe_essential, export_file, show_verdict
from dynident_service.adapters.measurements import (
    describe_file_problem,
    describe_recording,
    describe_standstills,
    import_file,
    inspect_upload,
    open_raw_signals,
    stream_raw_signals,
    thin_raw_signals,
)
from dynident_service.adapters.robots import (
    assign_mesh_files,
    build_robot,
    describe_geometry_with_meshes,
    describe_robot,
    find_base_parameters,
    place_mesh_files,
    restore_robot,
)
from dynident_service.problems import ProblemError
from dynident_service.wire_types.designs import DesignRequest
from dynident_service.wire_types.identifications import CorrelationView
from dynident_service.wire_types.measurements import ImportMetadata, MeasurementMetadata
from dynident_service.wire_types.robots import MeshView, RobotRequest
from dynident_service.wire_types.shared_types import to_plain_json


class SentCheck(TypedDict):
    """Check of a recording, as sent to the child process."""

    name: str
    status: Status
    detail: str


class SentMeasurement(TypedDict):
    """Measurement as sent to the child process; `recording` is a path."""

    id: str
    recording: str
    request: Mapping[str, object]
    checks: Sequence[SentCheck]


class SentOutcome(TypedDict):
    """Finished validation, as sent to the child process."""

    kind: str
    verdict: Verdict
    reason: str


def judge_model(
    model: str,
    fitted: Sequence[SentMeasurement],
    held_out: Sequence[SentMeasurement],
    outcomes: Sequence[SentOutcome] = (),
) -> dict[str, object]:
    """Return what the model in a file is fit for.

    Parameters
    ----------
    model : str
        Path of the model.
    fitted, held_out : sequence of SentMeasurement
        Measurements that the model was fitted to, and others.
    outcomes : sequence of SentOutcome
        Finished validations of the model.
    """
    names: set[str] = set()
    opened = (
        [_open_measurement(measurement, names) for measurement in fitted],
        [_open_measurement(measurement, names) for measurement in held_out],
    )
    pairs = zip([*opened[0], *opened[1]], [*fitted, *held_out], strict=True)
    checks = {measurement.recording.name: _build_checks(sent) for measurement, sent in pairs}
    recordings, validation = ([measurement.recording for measurement in group] for group in opened)
    ended = [Outcome(outcome["kind"], ValidationOutcome(outcome["verdict"], outcome["reason"])) for outcome in outcomes]
    result = verdict(from_bytes(Path(model).read_bytes()), recordings, validation, checks, ended)
    return to_plain_json(show_verdict(result, [*opened[0], *opened[1]]))


def _build_checks(measurement: SentMeasurement) -> list[Check]:
    return [Check(check["name"], check["status"], check["detail"]) for check in measurement["checks"]]


def _open_measurement(measurement: SentMeasurement, names: set[str]) -> SeenMeasurement:
    recording = open_recording(Path(measurement["recording"]))
    # The verdict refers to recordings by name, and two measurements may have the same one.
    name = recording.name if recording.name not in names else f"{recording.name} ({measurement['id']})"
    names.add(name)
    return SeenMeasurement(
        measurement["id"], replace(recording, name=name), MeasurementMetadata.model_validate(measurement["request"])
    )


def describe_requested_robot(request: Mapping[str, object]) -> dict[str, object]:
    """Return the description of a robot: its joints and its base parameters."""
    body = RobotRequest.model_validate(request)
    robot = build_robot(body)
    return to_plain_json(describe_robot(robot, find_base_parameters(robot, body.base_parameters_tolerance)))


def read_meshes(
    request: Mapping[str, object], sent: Mapping[str, str], kept: Mapping[str, str], destination: str
) -> dict[str, object]:
    """Read mesh files of a robot and write its geometry.

    Parameters
    ----------
    request : mapping
        Request that the robot was created by.
    sent : mapping of str to str
        Paths of uploaded files, by the names under which they were sent.
    kept : mapping of str to str
        Paths of the files that the robot has already, by mesh name.
    destination : str
        File for the geometry.

    Returns
    -------
    dict
        All meshes of the description (`meshes`), the uploaded file of each (`chosen`), and the files that belong to no
        mesh (`unused`).
    """
    robot = restore_robot(request)
    file_names = assign_mesh_files(robot, {name: Path(path) for name, path in sent.items()}) if sent else {}
    # What was sent now replaces what the robot had.
    files = {**kept, **{name: sent[file] for name, file in file_names.items()}}
    geometry = describe_geometry_with_meshes(robot, {name: Path(path) for name, path in files.items()})
    Path(destination).write_text(geometry.model_dump_json(), encoding="utf-8")
    meshes = [
        to_plain_json(MeshView(name=name, links=list(links))) for name, links in list_collision_meshes(robot).items()
    ]
    return {"meshes": meshes, "chosen": file_names, "unused": sorted(set(sent) - set(file_names.values()))}


def import_measurement(
    source: str, destination: str, robot: Mapping[str, object], metadata: Mapping[str, object], sha256: str
) -> dict[str, object]:
    """Check a recorded file, write it as a recording, and return its description."""
    sent_metadata = MeasurementMetadata.model_validate(metadata)
    try:
        recording, checks = import_file(Path(source), Path(destination), restore_robot(robot), sent_metadata)
    except RecordingError as error:
        # A problem can cross the pipe, with row or time and with all that was found in the file.
        raise ProblemError.from_problem(describe_file_problem(error)) from error
    return to_plain_json(describe_recording(recording, checks, sha256))


def inspect_file(
    source: str, robot: Mapping[str, object], metadata: Mapping[str, object], sha256: str
) -> dict[str, object]:
    """Return what the columns of a recorded file most probably are."""
    try:
        return to_plain_json(
            inspect_upload(Path(source), restore_robot(robot), ImportMetadata.model_validate(metadata), sha256)
        )
    except RecordingError as error:
        raise ProblemError.from_problem(describe_file_problem(error)) from error


def write_raw_signals(
    source: str,
    destination: str,
    robot: Mapping[str, object],
    metadata: Mapping[str, object],
    signals: list[str],
    start: float | None,
    end: float | None,
    points: int | None,
) -> None:
    """Write signals of a file as JSON.

    Parameters
    ----------
    source, destination : str
        Recorded file, and file to write.
    robot, metadata : mapping
        Request of the robot, and metadata of the file.
    signals : list of str
        Names of the signals.
    start, end : float or None
        Interval in seconds; None for the whole file.
    points : int or None
        Approximate number of samples; None for all.
    """
    opened = open_raw_signals(Path(source), restore_robot(robot), MeasurementMetadata.model_validate(metadata), signals)
    with Path(destination).open("wb") as file:
        # All samples are written as they are read: they may be larger than the memory.
        if points is None:
            file.writelines(stream_raw_signals(opened, start, end))
        else:
            file.write(thin_raw_signals(opened, points, start, end).model_dump_json().encode())


def find_standstills(recording: str) -> dict[str, object]:
    """Return the intervals in which every joint of a stored recording stands still."""
    return to_plain_json(describe_standstills(open_recording(Path(recording))))


def answer_clearances(
    request: Mapping[str, object], robot: Mapping[str, object], meshes: Mapping[str, str], trajectory: str, points: int
) -> dict[str, object]:
    """Return what the links of a robot come nearest to along a design; `meshes` are files by mesh name."""
    design_request = DesignRequest.model_validate(request)
    with place_mesh_files({name: Path(path) for name, path in meshes.items()}) as folders:
        return to_plain_json(
            compute_clearances(design_request, restore_robot(robot), Path(trajectory), folders, points)
        )


def essential(model: str, ratio: float) -> dict[str, object]:
    """Return the essential parameters of the model in a file."""
    return to_plain_json(describe_essential(essential_parameters(_read_model(model), ratio)))


def correlation(model: str) -> dict[str, object]:
    """Return how the estimates of the model in a file depend on one another."""
    return to_plain_json(to_view(CorrelationView, parameter_dependence(_read_model(model))))


def export(model: str, format: ExportFormat, nearest: bool, shown: Mapping[str, object]) -> ExportedFile:
    """Write the model in a file in another format."""
    return export_file(_read_model(model), format, nearest, dict(shown))


def _read_model(model: str) -> Identification:
    return from_bytes(Path(model).read_bytes())
