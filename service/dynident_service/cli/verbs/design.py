"""`dynident design`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import FOLDER_TO_READ, TO_READ
from dynident_service.cli.options import Accept, Columns, DriveGains, Effects, Json, RobotArgument, Seed, Units, Windows


def design(
    robot: RobotArgument,
    effects: Effects,
    columns: Columns,
    units: Units,
    windows: Windows,
    accept: Accept,
    kind: Annotated[
        str, typer.Option("--kind", help="optimized, random, sequential, constant_velocity, slow_sweep or reversals.")
    ] = "optimized",
    criterion: Annotated[
        str,
        typer.Option("--criterion", help="condition_number, d_optimal, a_optimal, e_optimal, … (§12.3.4)."),
    ] = "condition_number",
    family: Annotated[str, typer.Option("--family", help="fourier, b_spline or point_to_point.")] = "fourier",
    duration: Annotated[float, typer.Option("--duration", help="One period in s; of a set about one run.")] = 10.0,
    harmonics: Annotated[int, typer.Option("--harmonics", help="fourier: of the fundamental frequency.")] = 5,
    intervals: Annotated[int, typer.Option("--intervals", help="b_spline: between its knots.")] = 9,
    points: Annotated[int, typer.Option("--points", help="point_to_point: rests in a round.")] = 12,
    dwell: Annotated[
        tuple[float, float],
        typer.Option("--dwell", help="point_to_point: shortest and longest rest in a point, s.", show_default=False),
    ] = (0.0, 0.0),
    sets: Annotated[
        str, typer.Option("--sets", help="sequential: link_by_link, wrist_then_shoulder or vandanjon.")
    ] = "vandanjon",
    joints: Annotated[
        list[str] | None, typer.Option("--joint", help="Moves, the others stay at home; may be repeated. Else all.")
    ] = None,
    periods: Annotated[int, typer.Option("--periods", help="How often the period is repeated.")] = 1,
    rate: Annotated[float, typer.Option("--rate", help="Sampling rate in Hz.")] = 100.0,
    time_budget: Annotated[
        float | None, typer.Option("--time-budget", help="Seconds of optimisation; the best so far is taken.")
    ] = None,
    limits: Annotated[
        Path | None,
        typer.Option(
            "--limits",
            metavar="FILE",
            help='Tighter limits for this experiment, JSON: {"joint": {"position": [lo, hi], "velocity": …}}.',
        ),
        TO_READ,
    ] = None,
    surroundings: Annotated[
        Path | None,
        typer.Option(
            "--surroundings",
            metavar="FILE",
            help='What not to touch, JSON: {"floor": z, "boxes": […], "walls": […], "tool_range": {…}, …}.',
        ),
        TO_READ,
    ] = None,
    meshes: Annotated[
        list[Path] | None,
        typer.Option("--meshes", metavar="FOLDER", help="Where the URDF's collision meshes are; may be repeated."),
        FOLDER_TO_READ,
    ] = None,
    torque_margin: Annotated[
        float, typer.Option("--torque-margin", help="Share by which torque may be larger than predicted.")
    ] = 0.0,
    diagnosis: Annotated[
        Path | None,
        typer.Option(
            "--diagnosis",
            metavar="FILE",
            help="Design the next experiment that a diagnosis proposes (`dynident diagnose --out`).",
        ),
        TO_READ,
    ] = None,
    model: Annotated[
        str, typer.Option("--model", help="Rows that the criterion is computed from: dynamic, filtered, energy, power.")
    ] = "dynamic",
    earlier: Annotated[
        list[Path] | None,
        typer.Option("--earlier", metavar="FILE", help="Measurement that the experiment complements; may be repeated."),
        TO_READ,
    ] = None,
    drive_gains: DriveGains = "",
    seed: Seed = 0,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="Trajectory: .csv, .parquet, .yaml (ROS 2).")
    ] = Path("trajectory.csv"),
    as_json: Json = False,
) -> None:
    """Design an exciting trajectory within the robot's limits.

    The options about columns, units, windows, checks and drive gains are for the measurements of --earlier.
    """
    from dynident.excitation import CriterionChoice, DesignRequest, TrajectoryRequest, design_experiment
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
    machine = inputs.robot_of(robot, drive_gains)
    asked = DesignRequest(
        kind=kind,
        effects=inputs.effects_of(effects, machine) or None,
        criterion=CriterionChoice(criterion),
        trajectory=TrajectoryRequest(
            family=family,
            duration=duration,
            harmonics=harmonics,
            intervals=intervals,
            points=points,
            dwell=dwell,
            sets=sets,
            joints=tuple(joints or ()),
            periods=periods,
            sampling_rate=rate,
        ),
        time_budget=time_budget,
        seed=seed,
        model=inputs.row_model_of(model),
    )
    request = replace(
        asked if diagnosis is None else proposed_design(diagnosis),
        limits=limits_of(limits),
        torque_margin=torque_margin,
        surroundings=surroundings_of(surroundings, meshes or []),
    )
    options = inputs.FileOptions(columns, units, windows, accept)
    with (
        terminal.progress_bar("design") as progress,
        inputs.loaded(earlier or [], machine, options, part(progress, 0.0, 0.1)) as (
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
