"""Jobs: identify drive gains; compare models of the motor current."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from dynident.errors import DynidentError
from dynident.identification import DriveGains, PayloadEstimate, identify_currents, identify_gains, payload_mass
from dynident.identification.identification_choices import KnownLoad
from dynident.identification.loads.payloads_of_recordings import PLAIN_EFFECTS
from dynident.presentation.model_tables import get_gain_unit
from dynident.progress import Progress, scale_progress
from dynident.recordings import Recording
from dynident.robot import Robot
from dynident_service.drive_gains.wire_types import (
    CurrentModelsRequest,
    CurrentModelsResult,
    DriveGainsRequest,
    DriveGainsResult,
    IdentifiedGain,
    WeighedLoad,
)
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.shared.field_by_field import from_wire_choices, to_request, to_view
from dynident_service.shared.stored_inputs import load_stored_robot, open_recording_by_id, open_stored_recordings
from dynident_service.shared.wire_types import to_plain_json


def find_gains(task: Task) -> Outcome:
    """Identify the drive gains from motions without and with a known load, and weigh further loads with them."""
    request = DriveGainsRequest.model_validate(task.subject.request)
    robot = load_stored_robot(task, request.robot_id)
    weigh = request.weigh or []
    steps = 1 + len(weigh)
    gains = _identify_gains(task, request, robot, scale_progress(task.progress, 0.0, 1 / steps))
    loads = []
    for index, identifier in enumerate(weigh):
        progress = scale_progress(task.progress, (1 + index) / steps, (2 + index) / steps)
        name = task.resources.get("measurement", identifier).name or identifier
        loads.append((identifier, name, _weigh_load(task, request, robot, gains, identifier, progress)))
    warnings = [
        f"{name} is one of the runs that gave the gains: its weighed mass confirms nothing."
        for identifier, name, _ in loads
        if identifier in request.loaded
    ]
    return Outcome(to_plain_json(describe_gains(robot, gains, loads, warnings)))


def _identify_gains(task: Task, request: DriveGainsRequest, robot: Robot, progress: Progress) -> DriveGains:
    unloaded, heavy = _open_recordings(task, request.unloaded, request.loaded)
    load = to_request(request, KnownLoad)
    loaded = [replace(recording, payload=load.override_payload(recording.payload)) for recording in heavy]
    with _map_error_pointers("/unloaded", "/loaded", len(unloaded)):
        return identify_gains(robot, unloaded, loaded, progress=progress)


def _weigh_load(
    task: Task, request: DriveGainsRequest, robot: Robot, gains: DriveGains, identifier: str, progress: Progress
) -> PayloadEstimate:
    without, without_pointer = request.unloaded, "/unloaded"
    if request.weigh_unloaded is not None:
        without, without_pointer = request.weigh_unloaded, "/weigh_unloaded"
    unloaded, (loaded,) = _open_recordings(task, without, [identifier])
    with _map_error_pointers(without_pointer, "/weigh", len(unloaded)):
        return payload_mass(robot, unloaded, loaded, gains=gains, progress=progress)


def _open_recordings(
    task: Task, unloaded: Sequence[str], loaded: Sequence[str]
) -> tuple[list[Recording], list[Recording]]:
    """Open measurements without and with the load; equal names are made distinct by their ids."""
    identifiers = [*unloaded, *loaded]
    recordings = [open_recording_by_id(task, identifier) for identifier in identifiers]
    # The library names runs by their recordings: equal names would be one run.
    names = Counter(recording.name for recording in recordings)
    distinct = [
        replace(recording, name=f"{recording.name} ({identifier})") if names[recording.name] > 1 else recording
        for identifier, recording in zip(identifiers, recordings, strict=True)
    ]
    return distinct[: len(unloaded)], distinct[len(unloaded) :]


@contextmanager
def _map_error_pointers(unloaded: str, loaded: str, count: int) -> Iterator[None]:
    """Map error pointers of the library to fields of the request; the first `count` recordings are without the load."""
    try:
        yield
    except DynidentError as error:
        _, field, *rest = error.pointer.split("/") if error.pointer.startswith("/") else ("", "")
        if field == "measurement_ids" and rest and rest[0].isdecimal():
            index = int(rest[0])
            error.pointer = f"{unloaded}/{index}" if index < count else f"{loaded}/{index - count}"
        elif field == "unloaded_ids":
            error.pointer = unloaded
        elif field == "drives":
            error.pointer = "/robot_id"
        else:
            # What the runs do not determine between them is mended by other runs with the load.
            error.pointer = loaded
        raise


def find_currents(task: Task) -> Outcome:
    """Identify every joint's parameters in units of its current."""
    request = CurrentModelsRequest.model_validate(task.subject.request)
    joint_models = identify_currents(
        load_stored_robot(task, request.robot_id),
        open_stored_recordings(task, request.measurement_ids),
        open_stored_recordings(task, request.validation_ids),
        effects=from_wire_choices(request.effects) if request.effects else PLAIN_EFFECTS,
        progress=task.progress,
    )
    return Outcome(to_plain_json(to_view(CurrentModelsResult, None, joints=joint_models)))


def describe_gains(
    robot: Robot,
    drive_gains: DriveGains,
    loads: Sequence[tuple[str, str, PayloadEstimate]] = (),
    warnings: Sequence[str] = (),
) -> DriveGainsResult:
    """Build the view of drive gains, and of loads weighed with them (id and name of the measurement, estimate)."""
    gains = [
        to_view(IdentifiedGain, gain, unit=get_gain_unit(robot, index, drive_gains.from_commands))
        for index, gain in enumerate(drive_gains.each)
    ]
    weighed = [
        to_view(WeighedLoad, load, measurement_id=measurement_id, name=name) for measurement_id, name, load in loads
    ]
    return DriveGainsResult(gains=gains, loads=weighed, warnings=[*drive_gains.warnings, *warnings])
