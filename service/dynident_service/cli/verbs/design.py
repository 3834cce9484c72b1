"""`dynident design`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

from dynident.excitation.request import DesignRequest
from dynident_service.cli.asked import Asks, Typed
from dynident_service.cli.files import FOLDER_TO_READ, TO_READ
from dynident_service.cli.options import Effects, Json, RobotArgument, RobotReading


@dataclass(frozen=True)
class Beside:
    """What a design takes from files."""

    limits: Annotated[
        Path | None,
        typer.Option(
            "--limits",
            metavar="FILE",
            help='Tighter limits for this experiment, JSON: {"joint": {"position": [lo, hi], "velocity": …}}.',
        ),
        TO_READ,
    ] = None
    surroundings: Annotated[
        Path | None,
        typer.Option(
            "--surroundings",
            metavar="FILE",
            help='What not to touch, JSON: {"floor": z, "boxes": […], "walls": […], "tool_range": {…}, …}.',
        ),
        TO_READ,
    ] = None
    meshes: Annotated[
        list[Path] | None,
        typer.Option("--meshes", metavar="FOLDER", help="Where the URDF's collision meshes are; may be repeated."),
        FOLDER_TO_READ,
    ] = None
    diagnosis: Annotated[
        Path | None,
        typer.Option(
            "--diagnosis",
            metavar="FILE",
            help="Design the next experiment that a diagnosis proposes (`dynident diagnose --out`).",
        ),
        TO_READ,
    ] = None
    earlier: Annotated[
        list[Path] | None,
        typer.Option("--earlier", metavar="FILE", help="Measurement that the experiment complements; may be repeated."),
        TO_READ,
    ] = None


def design(
    robot: RobotArgument,
    effects: Effects,
    asked: Annotated[Typed, Asks(DesignRequest)],
    beside: Beside,
    reading: RobotReading,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="Trajectory: .csv, .parquet, .yaml (ROS 2).")
    ] = Path("trajectory.csv"),
    as_json: Json = False,
) -> None:
    """Design an exciting trajectory within the robot's limits.

    The options about columns, units, windows, checks and drive gains are for the measurements of --earlier.
    """
    from dynident.excitation import design_experiment
    from dynident.progress import part
    from dynident_service.adapters.designs import describe_design
    from dynident_service.cli import inputs, tables, terminal
    from dynident_service.cli.designing import (
        limits_of,
        proposed_design,
        show_design,
        surroundings_of,
        warn_of_unchecked,
    )
    from dynident_service.models.common import plain

    tables.check_ending(out, tables.TRAJECTORY_ENDINGS)
    machine = inputs.robot_of(robot, reading)
    wanted = asked.request(DesignRequest, effects=inputs.effects_of(effects, machine) or None)
    request = replace(
        wanted if beside.diagnosis is None else proposed_design(beside.diagnosis),
        limits=limits_of(beside.limits),
        torque_margin=wanted.torque_margin,
        surroundings=surroundings_of(beside.surroundings, beside.meshes or []),
    )
    with (
        terminal.progress_bar("design") as progress,
        inputs.loaded(beside.earlier or [], machine, reading, part(progress, 0.0, 0.1)) as (
            runs,
            _,
        ),
    ):
        found = design_experiment(machine, request, part(progress, 0.1, 1.0), inputs.recordings_of(runs))
    tables.write_trajectory(found, out)
    warn_of_unchecked(terminal.err(), found)
    if as_json:
        terminal.print_json(plain(describe_design(found)))
        return
    console = terminal.out()
    show_design(console, found)
    console.print(f"trajectory written to {out}", markup=False)
