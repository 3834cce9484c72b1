"""The experiment: trajectories are designed, the virtual robot follows them, its sensors write files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from dynident.excitation import Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.progress import Progress, part
from dynident.simulation import Measurement, Reference, Sensors, VirtualRobot, measurement_table
from dynident_service.cli.inputs import write_whole
from dynident_service.cli.tables import trajectory_table, write_table
from dynident_service.demo.scenario import Scenario

# Friction is not determined where a joint stands still: the rest at either end is left out, with some room.
_ROOM = 0.5
_DESIGN_RATE = 200.0


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One recording as a user has it: a file, and the seconds of it that are worth using."""

    path: Path
    window: tuple[float, float]
    design: Design
    n_samples: int

    @property
    def windows_option(self) -> str:
        """The window as the command line reads it."""
        return f"{self.path.stem}={self.window[0]:.6g}:{self.window[1]:.6g}"


def design_runs(scenario: Scenario, progress: Progress) -> list[Design]:
    """Two optimised trajectories to identify from, and one of another kind to try the model on."""
    plan, seed = scenario.plan, scenario.seed

    def wanted(kind: str, period: float, harmonics: int, periods: int, number: int) -> DesignRequest:
        return DesignRequest(
            kind=kind,
            trajectory=TrajectoryRequest(
                duration=period, harmonics=harmonics, periods=periods, sampling_rate=_DESIGN_RATE
            ),
            limits=scenario.limits,
            time_budget=plan.time_budget if kind == "optimized" else None,
            seed=3 * seed + number,
        )

    requests = [
        wanted("optimized", plan.period, 5, plan.periods[0], 0),
        wanted("optimized", plan.period, 4, plan.periods[1], 1),
        wanted("random", plan.validation_period, 6, 1, 2),
    ]
    return [
        design_experiment(scenario.robot, request, part(progress, index / 3, (index + 1) / 3))
        for index, request in enumerate(requests)
    ]


def measure(scenario: Scenario, designs: Sequence[Design], folder: Path, progress: Progress) -> list[MeasuredRun]:
    """Let the virtual robot follow the trajectories; write what its sensors give, and nothing else of it."""
    virtual = VirtualRobot(scenario.robot, scenario.effects, inertias=scenario.inertias)
    sensors = Sensors(sampling_rate=scenario.plan.rate)
    total = sum(design.duration for design in designs)
    names = ("run1", "run2", "validation")
    runs, done = [], 0.0
    for index, (name, design) in enumerate(zip(names, designs, strict=True)):
        share = part(progress, done / total, (done + design.duration) / total)
        found = virtual.measure(reference_of(design), sensors, seed=3 * scenario.seed + index, progress=share)
        write_table(trajectory_table(design), folder / f"trajectory_{name}.csv")
        runs.append(_written(found, design, folder / f"{name}.csv"))
        done += design.duration
    return runs


def seal(scenario: Scenario, path: Path) -> None:
    """Write down what was hidden, to be opened at the end."""
    hidden = None if scenario.hidden is None else asdict(scenario.hidden)
    write_whole(path, json.dumps({"hidden": hidden, "seed": scenario.seed}, indent=1).encode())


def reference_of(design: Design) -> Reference:
    """The motion of a design as the robot's controller takes it."""
    return Reference(design.t, design.q, design.dq, design.ddq)


def _written(found: Measurement, design: Design, path: Path) -> MeasuredRun:
    write_table(measurement_table(found), path)
    first, last = design.exciting
    return MeasuredRun(path, (first + _ROOM, last - _ROOM), design, found.n_samples)
