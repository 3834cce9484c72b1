"""Jobs that measure a virtual robot."""

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
    """Have a virtual robot make a motion; what its sensors give becomes a measurement."""
    asked = SimulationRequest.model_validate(task.subject.request)
    robot = robot_by_id(task, asked.robot_id)
    stated = taken(asked, Simulated)
    reference, rate = _motion(task, asked, robot, stated.seed)
    request = simulation_of(stated, robot, reference, rate)
    found = simulate(robot, request, part(task.progress, 0.3, 0.9))
    name = asked.name or f"simulation {task.subject.id}"
    told = RecordingMetadata(name, role=asked.role)
    said = body(MeasurementMetadata, told, robot_id=asked.robot_id)
    with tempfile.TemporaryDirectory() as folder:
        source = write_measurement(found, Path(folder) / "measurement.parquet")
        recording, checks = import_file(source, Path(folder) / "recording.parquet", robot, said)
        original = task.keep("original", source, PARQUET)
        canonical = task.keep("recording", Path(folder) / "recording.parquet", PARQUET)
        measurement = NewResource(
            "measurement",
            plain(said),
            name=name,
            result=plain(describe_recording(recording, checks, original.key)),
            rests_on=(RestsOn(asked.robot_id, "robot", "robot", "/robot_id"),),
            objects=(original, canonical),
        )
    result = simulations.describe_simulation(found, request.sensors.sampling_rate)
    return Outcome(plain(result), creates=measurement)


def _motion(task: Task, asked: SimulationRequest, robot: Robot, seed: int) -> tuple[Reference, float]:
    """The motion wanted, and its sampling rate in Hz."""
    if isinstance(asked.trajectory, Samples):
        return simulations.reference_of(asked.trajectory), simulations.RATE_OF_SAMPLES
    if asked.trajectory is not None:
        request = designs.random_design(asked.trajectory, robot, seed)
        design = design_experiment(robot, request, part(task.progress, 0.0, 0.3))
        return designs.reference_of_design(design), design.sampling_rate
    stored = task.resources.get("design", asked.design_id or "")
    result = DesignResult.model_validate(stored.result)
    path = task.objects.path(stored.objects["trajectory"].key)
    return designs.stored_reference(path, result.joints), result.sampling_rate
