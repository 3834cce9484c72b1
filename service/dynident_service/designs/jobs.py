"""What child processes compute of designs: jobs that design an experiment or simulate a measurement; clearances."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from dynident.excitation import design_experiment
from dynident.identification.robot_recording_import import import_for_robot
from dynident.progress import scale_progress
from dynident.recordings import RecordingMetadata
from dynident.robot import Robot
from dynident.simulation import Reference, Simulated, build_simulation_request, simulate, write_simulated_recording
from dynident_service.designs import adapters as designs
from dynident_service.designs.adapters import compute_clearances, describe_design, to_checked_request, write_trajectory
from dynident_service.designs.wire_types import DesignRequest, DesignResult, Samples, SimulationRequest
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.measurements.adapters import describe_recording, to_recording_metadata
from dynident_service.measurements.wire_types import MeasurementMetadata
from dynident_service.robots.adapters import (
    place_mesh_files,
    restore_robot,
)
from dynident_service.shared.field_by_field import to_body, to_request
from dynident_service.shared.stored_inputs import load_stored_model, load_stored_robot, open_stored_recordings
from dynident_service.shared.wire_types import to_plain_json
from dynident_service.storage.repository_values import Dependency, NewResource, find_mesh_files


def design(task: Task) -> Outcome:
    """Design an experiment."""
    sent_request = DesignRequest.model_validate(task.subject.request)
    robot = load_stored_robot(task, sent_request.robot_id)
    earlier = open_stored_recordings(task, sent_request.earlier_ids)
    model_id = sent_request.identification_id
    identified = None if model_id is None else load_stored_model(task, model_id).estimate
    meshes = find_mesh_files(task.resources.get("robot", sent_request.robot_id))
    # Descriptions name meshes by path, so the stored files are given these names in a temporary folder.
    with place_mesh_files({name: task.objects.fetch_file(file.key) for name, file in meshes.items()}) as folders:
        request = to_checked_request(sent_request, robot)
        surroundings = replace(request.surroundings, mesh_folders=tuple(map(str, folders)))
        planned = design_experiment(
            robot, replace(request, surroundings=surroundings), task.progress, earlier, task.checkpoints, identified
        )
    with tempfile.TemporaryDirectory() as folder:
        path = write_trajectory(planned, Path(folder) / "trajectory.parquet")
        trajectory = task.store_file("trajectory", path, "application/vnd.apache.parquet")
    return Outcome(to_plain_json(describe_design(planned)), (trajectory,))


PARQUET = "application/vnd.apache.parquet"


def measure_virtual_robot(task: Task) -> Outcome:
    """Simulate a motion of a virtual robot; the readings of its sensors become a measurement."""
    sent_request = SimulationRequest.model_validate(task.subject.request)
    robot = load_stored_robot(task, sent_request.robot_id)
    simulation_choices = to_request(sent_request, Simulated)
    reference, rate = _plan_motion(task, sent_request, robot, simulation_choices.seed)
    request = build_simulation_request(simulation_choices, robot, reference, rate)
    simulated = simulate(robot, request, scale_progress(task.progress, 0.3, 0.9))
    name = sent_request.name or f"simulation {task.subject.id}"
    recording_metadata = RecordingMetadata(name, role=sent_request.role)
    metadata = to_body(MeasurementMetadata, recording_metadata, robot_id=sent_request.robot_id)
    with tempfile.TemporaryDirectory() as folder:
        source = write_simulated_recording(simulated, Path(folder) / "measurement.parquet")
        # Imported like an uploaded file, so that a simulated measurement has passed the same checks as a real one.
        recording, checks = import_for_robot(
            robot, source, Path(folder) / "recording.parquet", to_recording_metadata(metadata)
        )
        original = task.store_file("original", source, PARQUET)
        canonical = task.store_file("recording", Path(folder) / "recording.parquet", PARQUET)
        measurement = NewResource(
            "measurement",
            to_plain_json(metadata),
            name=name,
            result=to_plain_json(describe_recording(recording, checks, original.key)),
            rests_on=(Dependency(sent_request.robot_id, "robot", "robot", "/robot_id"),),
            objects=(original, canonical),
        )
    result = designs.describe_simulation(simulated, request.sensors.sampling_rate)
    return Outcome(to_plain_json(result), creates=measurement)


def _plan_motion(task: Task, sent_request: SimulationRequest, robot: Robot, seed: int) -> tuple[Reference, float]:
    """Return the motion to simulate, and its sampling rate in Hz."""
    # Three sources of a motion: samples as they are, a random motion of a family, or a stored design.
    if isinstance(sent_request.trajectory, Samples):
        return designs.samples_to_reference(sent_request.trajectory), designs.RATE_OF_SAMPLES
    if sent_request.trajectory is not None:
        request = designs.build_random_design(sent_request.trajectory, robot, seed)
        design = design_experiment(robot, request, scale_progress(task.progress, 0.0, 0.3))
        return designs.design_to_reference(design), design.sampling_rate
    stored = task.resources.get("design", sent_request.design_id or "")
    designs.to_design_request(DesignRequest.model_validate(stored.request)).standing.refuse_simulation()
    result = DesignResult.model_validate(stored.result)
    path = task.objects.fetch_file(stored.objects["trajectory"].key)
    return designs.read_reference(path, result.joints), result.sampling_rate


def answer_clearances(
    request: Mapping[str, object], robot: Mapping[str, object], meshes: Mapping[str, str], trajectory: str, points: int
) -> dict[str, object]:
    """Return what the links of a robot come nearest to along a design; `meshes` are files by mesh name."""
    design_request = DesignRequest.model_validate(request)
    with place_mesh_files({name: Path(path) for name, path in meshes.items()}) as folders:
        return to_plain_json(
            compute_clearances(design_request, restore_robot(robot), Path(trajectory), folders, points)
        )
