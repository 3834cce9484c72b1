"""The experiment: trajectories are designed, the virtual robot follows them, its sensors write files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from dynident.excitation import Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.progress import Progress, part
from dynident.simulation import (
    Measurement,
    Reference,
    Sensors,
    VirtualRobot,
    measurement_table,
)
from dynident.simulation.typical import largest_torque
from dynident_service.cli.inputs import write_whole
from dynident_service.cli.tables import write_table, write_trajectory
from dynident_service.demo.scenario import Scenario

# Where a joint stands still, or nearly so for a while, it may stick, and its torque is then not determined by any
# motion: slower than this (rad/s or m/s) for longer than this (s) is left out, with some room (s) around it.
_SLOW, _LONG, _ROOM = 0.012, 0.06, 0.1
_SHORTEST_WINDOW = 0.6
_DESIGN_RATE = 200.0


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One recording as a user has it: a file, and the seconds of it that are worth using."""

    path: Path
    windows: tuple[tuple[float, float], ...]
    design: Design
    n_samples: int

    @property
    def windows_option(self) -> str:
        """The windows as the command line reads them."""
        return f"{self.path.stem}={','.join(f'{first:.9g}:{last:.9g}' for first, last in self.windows)}"


def design_runs(scenario: Scenario, progress: Progress) -> list[Design]:
    """A design for every course of the plan."""
    courses = scenario.plan.courses
    found = []
    for index, course in enumerate(courses):
        request = DesignRequest(
            kind=course.kind,
            trajectory=TrajectoryRequest(
                duration=course.period,
                harmonics=course.harmonics,
                periods=course.periods,
                sampling_rate=_DESIGN_RATE,
            ),
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
        runs.append(_written(found, design, begins, folder / f"{course.name}.csv"))
        done += design.duration
    return runs


def seal(scenario: Scenario, path: Path) -> None:
    """Write down what was hidden, to be opened at the end."""
    hidden = None if scenario.hidden is None else asdict(scenario.hidden)
    write_whole(path, json.dumps({"hidden": hidden, "seed": scenario.seed}, indent=1).encode())


def reference_of(design: Design, begins: float = 0.0) -> Reference:
    """The motion of a design as the robot's controller takes it, from a time of the session (s) on."""
    return Reference(design.t + begins, design.q, design.dq, design.ddq)


def _written(found: Measurement, design: Design, begins: float, path: Path) -> MeasuredRun:
    write_table(measurement_table(found), path)
    windows = tuple((begins + first, begins + last) for first, last in _in_motion(design))
    return MeasuredRun(path, windows, design, found.n_samples)


def _in_motion(design: Design) -> tuple[tuple[float, float], ...]:
    """The stretches of a design's exciting part in which no joint dwells, in seconds of t."""
    first, last = design.exciting
    period = 1.0 / design.sampling_rate
    usable = (design.t >= first) & (design.t <= last)
    room = round(_ROOM / period)
    for joint in range(design.dq.shape[1]):
        for start, end in _stretches(np.abs(design.dq[:, joint]) < _SLOW):
            if (end - start) * period > _LONG:
                usable[max(0, start - room) : end + room] = False
    windows = ((float(design.t[start]), float(design.t[end - 1])) for start, end in _stretches(usable))
    return tuple((start, end) for start, end in windows if end - start >= _SHORTEST_WINDOW)


def _stretches(mask: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[tuple[int, int]]:
    """First index and end of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
