"""Computations that requests wait for: plain values in, plain values out, as they cross a pipe."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from dynident.export import ExportedFile, ExportFormat
from dynident.identification import Identification, from_bytes
from dynident.identification.study.dependence import parameter_dependence
from dynident.identification.study.essential import essential_parameters
from dynident.recordings import RecordingError, open_recording
from dynident.robot.collision import collision_meshes
from dynident_service.adapters.answers import shown
from dynident_service.adapters.designs import clearances_of
from dynident_service.adapters.exports import exported_file
from dynident_service.adapters.identifications import describe_essential
from dynident_service.adapters.imports import look_at
from dynident_service.adapters.measurements import describe_recording, import_file, problem_with_file
from dynident_service.adapters.meshes import chosen, geometry_with, mesh_folders
from dynident_service.adapters.raw_signals import as_recorded, standstills, streamed, thinned
from dynident_service.adapters.robots import base_parameters_of, describe_robot, robot_from_request, robot_of
from dynident_service.models.common import plain
from dynident_service.models.designs import DesignRequest
from dynident_service.models.identifications import CorrelationView
from dynident_service.models.imports import ImportMetadata
from dynident_service.models.measurements import MeasurementMetadata
from dynident_service.models.robots import MeshView, RobotRequest
from dynident_service.problems import ProblemError


def describe(request: Mapping[str, object]) -> dict[str, object]:
    """Return the description of a robot: its joints and its base parameters."""
    body = RobotRequest.model_validate(request)
    robot = robot_from_request(body)
    return plain(describe_robot(robot, base_parameters_of(robot, body.base_parameters_tolerance)))


def take_meshes(
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
    robot = robot_of(request)
    file_names = chosen(robot, {name: Path(path) for name, path in sent.items()}) if sent else {}
    files = {**kept, **{name: sent[file] for name, file in file_names.items()}}
    geometry = geometry_with(robot, {name: Path(path) for name, path in files.items()})
    Path(destination).write_text(geometry.model_dump_json(), encoding="utf-8")
    meshes = [plain(MeshView(name=name, links=list(links))) for name, links in collision_meshes(robot).items()]
    return {"meshes": meshes, "chosen": file_names, "unused": sorted(set(sent) - set(file_names.values()))}


def import_measurement(
    source: str, destination: str, robot: Mapping[str, object], metadata: Mapping[str, object], sha256: str
) -> dict[str, object]:
    """Check a recorded file, write it as a recording, and return its description."""
    sent_metadata = MeasurementMetadata.model_validate(metadata)
    try:
        recording, checks = import_file(Path(source), Path(destination), robot_of(robot), sent_metadata)
    except RecordingError as error:
        raise ProblemError.of(problem_with_file(error)) from error
    return plain(describe_recording(recording, checks, sha256))


def look_at_file(
    source: str, robot: Mapping[str, object], metadata: Mapping[str, object], sha256: str
) -> dict[str, object]:
    """Return what the columns of a recorded file most probably are."""
    try:
        return plain(look_at(Path(source), robot_of(robot), ImportMetadata.model_validate(metadata), sha256))
    except RecordingError as error:
        raise ProblemError.of(problem_with_file(error)) from error


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
    opened = as_recorded(Path(source), robot_of(robot), MeasurementMetadata.model_validate(metadata), signals)
    with Path(destination).open("wb") as file:
        if points is None:
            file.writelines(streamed(opened, start, end))
        else:
            file.write(thinned(opened, points, start, end).model_dump_json().encode())


def find_standstills(recording: str) -> dict[str, object]:
    """Return the intervals in which every joint of a stored recording stands still."""
    return plain(standstills(open_recording(Path(recording))))


def clearances(
    request: Mapping[str, object], robot: Mapping[str, object], meshes: Mapping[str, str], trajectory: str, points: int
) -> dict[str, object]:
    """Return what the links of a robot come nearest to along a design; `meshes` are files by mesh name."""
    design_request = DesignRequest.model_validate(request)
    with mesh_folders({name: Path(path) for name, path in meshes.items()}) as folders:
        return plain(clearances_of(design_request, robot_of(robot), Path(trajectory), folders, points))


def essential(model: str, ratio: float) -> dict[str, object]:
    """Return the essential parameters of the model in a file."""
    return plain(describe_essential(essential_parameters(_read(model), ratio)))


def correlation(model: str) -> dict[str, object]:
    """Return how the estimates of the model in a file depend on one another."""
    return plain(shown(CorrelationView, parameter_dependence(_read(model))))


def export(model: str, format: ExportFormat, nearest: bool, shown: Mapping[str, object]) -> ExportedFile:
    """Write the model in a file in another format."""
    return exported_file(_read(model), format, nearest, dict(shown))


def _read(model: str) -> Identification:
    return from_bytes(Path(model).read_bytes())
