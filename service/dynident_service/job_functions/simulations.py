"""Job: simulate measurements of a virtual robot."""

from __future__ import annotations

import tempfile
from pathlib import Path

from dynident.excitation import design_experiment
from dynident.progress import scale_progress
from dynident.recordings import RecordingMetadata
from dynident.robot import Robot
from dynident.simulation import Reference, Simulated, build_simulation_request, simulate, write_simulated_recording
from dynident_service.adapters import designs
from dynident_service.adapters.field_by_field import to_body, to_request
from dynident_service.adapters.measurements import describe_recording, import_file
from dynident_service.job_functions.stored_inputs import load_stored_robot
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.storage.repository_values import Dependency, NewResource
from dynident_service.wire_types.designs import DesignResult, Samples, SimulationRequest
from dynident_service.wire_types.measurements import MeasurementMetadata
from dynident_service.wire_types.shared_types import to_plain_json

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
        recording, checks = import_file(source, Path(folder) / "recording.parquet", robot, metadata)
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
    result = DesignResult.model_validate(stored.result)
    path = task.objects.fetch_file(stored.objects["trajectory"].key)
    return designs.read_reference(path, result.joints), result.sampling_rate
