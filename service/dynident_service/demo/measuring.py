"""The experiment: trajectories are designed, the virtual robot follows them, its sensors write files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from dynident.effects.sizes import largest_torque
from dynident.excitation import Design, DesignRequest, design_experiment
from dynident.progress import Progress, part
from dynident.simulation import (
    Reference,
    Sensors,
    VirtualRobot,
    measurement_table,
)
from dynident_service.cli.files import write_whole
from dynident_service.cli.tables import write_table, write_trajectory
from dynident_service.demo.scenario import Scenario

# Random motions from point to point that the best is taken of: each takes a second to find.
_FEW = 4


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One recording as a user has it: a file, all of it, and the design it was made by."""

    path: Path
    design: Design
    n_samples: int


def design_runs(scenario: Scenario, progress: Progress) -> list[Design]:
    """A design for every course of the plan."""
    courses = scenario.plan.courses
    found = []
    for index, course in enumerate(courses):
        request = DesignRequest(
            kind=course.kind,
            trajectory=course.trajectory,
            random_trajectories=_FEW if course.points else DesignRequest.random_trajectories,
            limits=scenario.limits(course),
            # A number of starts, not seconds: the same seed then gives the same trajectory on any machine.
            starts=course.starts,
            noise=_noise_of(scenario),
            seed=len(courses) * scenario.seed + index,
        )
        share = part(progress, index / len(courses), (index + 1) / len(courses))
        found.append(design_experiment(scenario.robot, request, share))
    return found


def _noise_of(scenario: Scenario) -> dict[str, float]:
    """What the torque sensors leave of every sample, as the robot's data sheet would state it."""
    sensors = Sensors(sampling_rate=scenario.plan.rate)
    names = scenario.robot.joint_names
    return {name: sensors.torque_noise * largest_torque(scenario.robot, j) for j, name in enumerate(names)}


def measure(scenario: Scenario, designs: Sequence[Design], folder: Path, progress: Progress) -> list[MeasuredRun]:
    """Let the virtual robot follow the trajectories; write what its sensors give, and nothing else of it."""
    virtual = VirtualRobot(scenario.robot, scenario.effects, inertias=scenario.inertias)
    sensors = Sensors(sampling_rate=scenario.plan.rate)
    total = sum(design.duration for design in designs)
    runs, done = [], 0.0
    for index, (course, design) in enumerate(zip(scenario.plan.courses, designs, strict=True)):
        share = part(progress, done / total, (done + design.duration) / total)
        seed = len(designs) * scenario.seed + index
        begins = scenario.begins(course)
        reference = reference_of(design, begins)
        if scenario.warms_up:
            temperature = scenario.temperature(reference.t)
            reference = replace(reference, temperature=np.repeat(temperature[:, None], scenario.robot.n, axis=1))
        found = virtual.measure(reference, sensors, run=course.name, seed=seed, progress=share)
        write_trajectory(design, folder / f"trajectory_{course.name}.csv")
        write_table(measurement_table(found), folder / f"{course.name}.csv")
        runs.append(MeasuredRun(folder / f"{course.name}.csv", design, found.n_samples))
        done += design.duration
    return runs


def seal(scenario: Scenario, path: Path) -> None:
    """Write down what was hidden, to be opened at the end."""
    hidden = None if scenario.hidden is None else asdict(scenario.hidden)
    write_whole(path, json.dumps({"hidden": hidden, "seed": scenario.seed}, indent=1).encode())


def reference_of(design: Design, begins: float = 0.0) -> Reference:
    """The motion of a design as the robot's controller takes it, from a time of the session (s) on."""
    return Reference(design.t + begins, design.q, design.dq, design.ddq)
