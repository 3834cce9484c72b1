"""The steps of the demonstration: design, record by the virtual robot, identify, diagnose."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

import dynident as dy
from dynident.advice import AdvisedDiagnosis
from dynident.api.model import Model
from dynident.api.model_report import Report
from dynident.api.motion_design import DesignedMotion
from dynident.array_types import FloatArray
from dynident.diagnosis import Comparison
from dynident.effects.usual_effect_sizes import get_largest_torque
from dynident.excitation import Design, DesignRequest, design_experiment
from dynident.file_output import write_atomically
from dynident.identification import Identification
from dynident.progress import Progress, scale_progress
from dynident.recordings.arrow_tables import write_table
from dynident.robot import Robot
from dynident.simulation import Reference, Sensors, VirtualRobot, build_recording_table
from dynident_cli.demo.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Analysis:
    """The results of all steps; the model has everything that the diagnosis recommends."""

    comparison: Comparison
    diagnosis: AdvisedDiagnosis
    model: Model
    report: Report

    @property
    def ladder(self) -> tuple[Identification, ...]:
        """The models from the first to the last."""
        return tuple(self.model.identification.ladder())

    @property
    def first(self) -> Identification:
        """The model before anything was added."""
        return self.ladder[0]

    @property
    def last(self) -> Identification:
        """The model with everything that was added."""
        return self.model.identification

    def compute_floor_ratio(self, model: Identification) -> FloatArray:
        """Return the held-out residual of a model over the noise floor, joint by joint, where joints move.

        Shape (n,); 1 is the best that a model can reach.
        """
        moving = model.held_out_moving
        assert moving is not None
        return moving.rms / self.diagnosis.noise_floor


def analyse_recordings(
    robot: Robot,
    training: Sequence[Path],
    held_out: Sequence[Path],
    design: Design,
    progress: Progress,
) -> Analysis:
    """Identify, compare, diagnose, add the recommended effects one by one, and write the report.

    `design` is of the first recording, for the report.
    """
    runs = dy.read_recordings(*training, *held_out, robot=robot, progress=scale_progress(progress, 0.0, 0.1))
    recordings, validation = runs[: len(training)], runs[len(training) :]
    # As any user would, with the usual effects and without a choice.
    model = dy.identify(robot, recordings, validation=validation, progress=scale_progress(progress, 0.1, 0.2))
    comparison = dy.compare(model, validation[:1])[0].comparison
    diagnosis = dy.diagnose(model, progress=scale_progress(progress, 0.2, 0.7))
    for index, choice in enumerate(diagnosis.recommended):
        progress(0.7 + 0.15 * index / len(diagnosis.recommended), f"adding {choice.effect}")
        model = model.extend(choice)
    progress(0.85, "writing the report")
    report = dy.report(
        model,
        diagnosis=diagnosis,
        design=DesignedMotion(robot, design),
        title=f"Demonstration: {robot.name}",
        progress=scale_progress(progress, 0.85, 1.0),
    )
    return Analysis(comparison, diagnosis.advised_diagnosis, model, report)


# Random motions from point to point, the best of which is taken: each takes a second to find.
_FEW_RANDOM_TRAJECTORIES = 4


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One recording as a user has it: the file, and the design of its motion."""

    path: Path
    design: Design
    n_samples: int


def design_runs(scenario: Scenario, progress: Progress) -> list[Design]:
    """Design a trajectory for every course of the plan."""
    courses = scenario.plan.courses
    designs = []
    for index, course in enumerate(courses):
        request = DesignRequest(
            kind=course.kind,
            trajectory=course.trajectory,
            random_trajectories=_FEW_RANDOM_TRAJECTORIES if course.points else DesignRequest.random_trajectories,
            limits=scenario.compute_limits(course),
            # A number of starts, not seconds: the same seed then gives the same trajectory on any machine.
            starts=course.starts,
            noise=_compute_torque_noise(scenario),
            # Every course of every scenario has a seed of its own.
            seed=len(courses) * scenario.seed + index,
        )
        share = scale_progress(progress, index / len(courses), (index + 1) / len(courses))
        designs.append(design_experiment(scenario.robot, request, share))
    return designs


def _compute_torque_noise(scenario: Scenario) -> dict[str, float]:
    """Return the standard deviation of each joint's torque sensor, as the robot's data sheet would state it."""
    sensors = Sensors(sampling_rate=scenario.plan.rate)
    names = scenario.robot.joint_names
    return {name: sensors.torque_noise * get_largest_torque(scenario.robot, j) for j, name in enumerate(names)}


def record_runs(scenario: Scenario, designs: Sequence[Design], folder: Path, progress: Progress) -> list[MeasuredRun]:
    """Let the virtual robot follow the trajectories, and write what its sensors record."""
    virtual = VirtualRobot(scenario.robot, scenario.effects, inertias=scenario.inertias)
    sensors = Sensors(sampling_rate=scenario.plan.rate)
    total = sum(design.duration for design in designs)
    runs, done = [], 0.0
    for index, (course, design) in enumerate(zip(scenario.plan.courses, designs, strict=True)):
        share = scale_progress(progress, done / total, (done + design.duration) / total)
        # The noise of every run of every scenario is another one.
        seed = len(designs) * scenario.seed + index
        # Effects that drift depend on the time of the session, in which the runs follow each other.
        begins = scenario.start_time(course)
        reference = to_reference(design, begins)
        if scenario.warms_up:
            temperature = scenario.compute_temperature(reference.t)
            reference = replace(reference, temperature=np.repeat(temperature[:, None], scenario.robot.n, axis=1))
        recording = virtual.measure(reference, sensors, run=course.name, seed=seed, progress=share)
        DesignedMotion(scenario.robot, design).save(folder / f"trajectory_{course.name}.csv")
        write_table(build_recording_table(recording), folder / f"{course.name}.csv")
        runs.append(MeasuredRun(folder / f"{course.name}.csv", design, recording.n_samples))
        done += design.duration
    return runs


def write_hidden_effect(scenario: Scenario, path: Path) -> None:
    """Write what was hidden to a file that is not read before the end."""
    hidden = None if scenario.hidden is None else asdict(scenario.hidden)
    write_atomically(path, json.dumps({"hidden": hidden, "seed": scenario.seed}, indent=1).encode())


def to_reference(design: Design, begins: float = 0.0) -> Reference:
    """Return the motion of a design as the robot's controller takes it.

    `begins` is the time of the session at which it starts, s.
    """
    return Reference(design.t + begins, design.q, design.dq, design.ddq)
