"""The steps of the demonstration: design, record by the virtual robot, identify, diagnose."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from dynident.advice import AdvisedDiagnosis, advise
from dynident.array_types import FloatArray
from dynident.diagnosis import Comparison, Diagnosis, compare, examine
from dynident.effects.usual_effect_sizes import get_largest_torque
from dynident.excitation import Design, DesignRequest, design_experiment
from dynident.identification import Identification, extend, identify
from dynident.progress import Progress, scale_progress
from dynident.recordings import Recording
from dynident.reports import html_report
from dynident.robot import Robot
from dynident.simulation import (
    Reference,
    Sensors,
    VirtualRobot,
    build_recording_table,
)
from dynident_cli.argument_loading import LoadedRecording, extract_recordings, load_recordings
from dynident_cli.command_output import build_reported_runs
from dynident_cli.csv_and_parquet_output import write_table, write_trajectory
from dynident_cli.demo.scenario import Scenario
from dynident_cli.input_checks_and_writes import write_atomically
from dynident_cli.shared_options import Reading


@dataclass(frozen=True, eq=False)
class Analysis:
    """The results of all steps; `ladder` holds the models from the first to the last."""

    training: tuple[LoadedRecording, ...]
    held_out: tuple[LoadedRecording, ...]
    comparison: Comparison
    diagnosis: AdvisedDiagnosis
    ladder: tuple[Identification, ...]
    report: str

    @property
    def first(self) -> Identification:
        """The model before anything was added."""
        return self.ladder[0]

    @property
    def last(self) -> Identification:
        """The model with everything that the diagnosis recommends."""
        return self.ladder[-1]

    def compute_floor_ratio(self, model: Identification) -> FloatArray:
        """Return the held-out residual of a model over the noise floor, joint by joint, where joints move.

        Parameters
        ----------
        model : Identification

        Returns
        -------
        (n,) array
            1 is the best that a model can reach.
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

    Parameters
    ----------
    robot : Robot
        As its description has it.
    training, held_out : sequence of Path
        Recorded files.
    design : Design
        Of the first recording, for the report.
    progress : function

    Returns
    -------
    Analysis
    """
    with load_recordings(training, robot, Reading(), scale_progress(progress, 0.0, 0.1), held_out) as (
        training_data,
        held_out_data,
    ):
        recordings, validation = extract_recordings(training_data), extract_recordings(held_out_data)
        # As any user would, with the usual effects and without a choice.
        first = identify(robot, recordings, validation, progress=scale_progress(progress, 0.1, 0.2))
        comparison = compare(first, validation[0])
        diagnosis = advise(examine(first, recordings, progress=scale_progress(progress, 0.2, 0.7)))
        ladder = _build_ladder(first, diagnosis, recordings, validation, scale_progress(progress, 0.7, 0.85))
        runs = build_reported_runs(ladder[-1], training_data, held_out_data, scale_progress(progress, 0.85, 0.9))
        progress(0.9, "writing the report")
        report = html_report(ladder[-1], runs, diagnosis=diagnosis, design=design, title=f"Demonstration: {robot.name}")
        return Analysis(tuple(training_data), tuple(held_out_data), comparison, diagnosis, tuple(ladder), report)


def _build_ladder(
    first: Identification,
    diagnosis: Diagnosis,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> list[Identification]:
    models = [first]
    for index, choice in enumerate(diagnosis.recommended):
        progress(index / len(diagnosis.recommended), f"adding {choice.effect}")
        models.append(extend(models[-1], [choice], recordings, validation))
    return models


# Random motions from point to point, the best of which is taken: each takes a second to find.
_FEW_RANDOM_TRAJECTORIES = 4


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One recording as a user has it: the file, and the design of its motion."""

    path: Path
    design: Design
    n_samples: int


def design_runs(scenario: Scenario, progress: Progress) -> list[Design]:
    """Design a trajectory for every course of the plan.

    Parameters
    ----------
    scenario : Scenario
    progress : function

    Returns
    -------
    list of Design
    """
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
    """Let the virtual robot follow the trajectories, and write what its sensors record.

    Parameters
    ----------
    scenario : Scenario
    designs : sequence of Design
        One for each course of the plan.
    folder : Path
        For the files.
    progress : function

    Returns
    -------
    list of MeasuredRun
    """
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
        write_trajectory(design, folder / f"trajectory_{course.name}.csv")
        write_table(build_recording_table(recording), folder / f"{course.name}.csv")
        runs.append(MeasuredRun(folder / f"{course.name}.csv", design, recording.n_samples))
        done += design.duration
    return runs


def write_hidden_effect(scenario: Scenario, path: Path) -> None:
    """Write what was hidden to a file that is not read before the end.

    Parameters
    ----------
    scenario : Scenario
    path : Path
    """
    hidden = None if scenario.hidden is None else asdict(scenario.hidden)
    write_atomically(path, json.dumps({"hidden": hidden, "seed": scenario.seed}, indent=1).encode())


def to_reference(design: Design, begins: float = 0.0) -> Reference:
    """Return the motion of a design as the robot's controller takes it.

    Parameters
    ----------
    design : Design
    begins : float
        Time of the session at which it starts, s.

    Returns
    -------
    Reference
    """
    return Reference(design.t + begins, design.q, design.dq, design.ddq)
