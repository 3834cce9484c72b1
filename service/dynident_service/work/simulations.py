"""Jobs that simulate measurements of a virtual robot."""

from __future__ import annotations

import tempfile
from pathlib import Path

from dynident.excitation import design_experiment
from dynident.progress import part
from dynident.recordings import RecordingMetadata
from dynident.robot import Robot
from dynident.simulation import Reference, Simulated, simulate, simulation_of, write_measurement
from dynident_service.adapters import designs, simulations
from dynident_service.adapters.derived import body, taken
from dynident_service.adapters.measurements import describe_recording, import_file
from dynident_service.jobs.work import Outcome, Task
from dynident_service.models.common import plain
from dynident_service.models.designs import DesignResult
from dynident_service.models.measurements import MeasurementMetadata
from dynident_service.models.simulations import Samples, SimulationRequest
from dynident_service.storage.records import NewResource, RestsOn
from dynident_service.work.means import robot_by_id

PARQUET = "application/vnd.apache.parquet"


def measure_virtual_robot(task: Task) -> Outcome:
    """Simulate a motion of a virtual robot; the readings of its sensors become a measurement."""
    sent_request = SimulationRequest.model_validate(task.subject.request)
    robot = robot_by_id(task, sent_request.robot_id)
    simulation_choices = taken(sent_request, Simulated)
    reference, rate = _motion(task, sent_request, robot, simulation_choices.seed)
    request = simulation_of(simulation_choices, robot, reference, rate)
    simulated = simulate(robot, request, part(task.progress, 0.3, 0.9))
    name = sent_request.name or f"simulation {task.subject.id}"
    recording_metadata = RecordingMetadata(name, role=sent_request.role)
    metadata = body(MeasurementMetadata, recording_metadata, robot_id=sent_request.robot_id)
    with tempfile.TemporaryDirectory() as folder:
        source = write_measurement(simulated, Path(folder) / "measurement.parquet")
        # Imported like an uploaded file, so that a simulated measurement has passed the same checks as a real one.
        recording, checks = import_file(source, Path(folder) / "recording.parquet", robot, metadata)
        original = task.keep("original", source, PARQUET)
        canonical = task.keep("recording", Path(folder) / "recording.parquet", PARQUET)
        measurement = NewResource(
            "measurement",
            plain(metadata),
            name=name,
            result=plain(describe_recording(recording, checks, original.key)),
            rests_on=(RestsOn(sent_request.robot_id, "robot", "robot", "/robot_id"),),
            objects=(original, canonical),
        )
    result = simulations.describe_simulation(simulated, request.sensors.sampling_rate)
    return Outcome(plain(result), creates=measurement)


def _motion(task: Task, sent_request: SimulationRequest, robot: Robot, seed: int) -> tuple[Reference, float]:
    """Return the motion to simulate, and its sampling rate in Hz."""
    if isinstance(sent_request.trajectory, Samples):
        return simulations.reference_of(sent_request.trajectory), simulations.RATE_OF_SAMPLES
    if sent_request.trajectory is not None:
        request = designs.random_design(sent_request.trajectory, robot, seed)
        design = design_experiment(robot, request, part(task.progress, 0.0, 0.3))
        return designs.reference_of_design(design), design.sampling_rate
    stored = task.resources.get("design", sent_request.design_id or "")
    result = DesignResult.model_validate(stored.result)
    path = task.objects.path(stored.objects["trajectory"].key)
    return designs.stored_reference(path, result.joints), result.sampling_rate
