"""`dynident gains`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.options import (
    Accept,
    Columns,
    DriveGains,
    Json,
    Measurements,
    RobotArgument,
    Units,
    Windows,
)


def gains(
    robot: RobotArgument,
    measurements: Measurements,
    loaded: Annotated[
        list[Path],
        typer.Option(
            "--loaded",
            metavar="FILE",
            help="Measurement of the same motion with the load; may be repeated.",
            show_default=False,
        ),
    ],
    columns: Columns,
    units: Units,
    windows: Windows,
    accept: Accept,
    mass: Annotated[float, typer.Option("--mass", help="What the load weighs, kg.", show_default=False)],
    centre: Annotated[
        str, typer.Option("--centre", metavar="X,Y,Z", help="Its centre in the last joint's frame, m, where known.")
    ] = "",
    drive_gains: DriveGains = "",
    as_json: Json = False,
) -> None:
    """Identify the drive gains from runs without and with a load of known mass.

    MEASUREMENT are the runs without the load. With currents and no idea of the gains, say --drive-gains 1,1,….
    """
    from dynident.identification import identify_gains
    from dynident.progress import part
    from dynident.reports.numbers import estimate, number
    from dynident_service.cli import inputs, parsing, terminal

    machine = inputs.robot_of(robot, drive_gains)
    payload = {"mass": mass, **({"centre": parsing.numbers(centre, "--centre")} if centre else {})}
    options = inputs.FileOptions(columns, units, windows, accept)
    with (
        terminal.progress_bar("gains") as progress,
        inputs.loaded(measurements, machine, options, part(progress, 0.0, 0.6), loaded) as (without, carrying),
    ):
        heavy = [replace(recording, payload=payload) for recording in inputs.recordings_of(carrying)]
        found = identify_gains(machine, inputs.recordings_of(without), heavy, progress=part(progress, 0.6, 1.0))
        progress(1.0, "solved")
    if as_json:
        terminal.print_json(
            {
                "joints": list(found.joint_names),
                "stated": found.stated.tolist(),
                "gains": found.values.tolist(),
                "standard_deviations": found.standard_deviations.tolist(),
                "intervals": found.intervals.tolist(),
                "identifiable": list(found.identifiable),
                "warnings": list(found.warnings),
            }
        )
        return
    console = terminal.out()
    rows = [
        [name, number(stated, 4), *estimate(value, 1.96 * deviation), "yes" if known else "no"]
        for name, stated, value, deviation, known in zip(
            found.joint_names, found.stated, found.values, found.standard_deviations, found.identifiable, strict=True
        )
    ]
    console.print(terminal.table("", ("joint", "stated", "gain", "± 95 %", "identifiable"), rows))
    said = ",".join(f"{value:.4g}" for value in found.values)
    console.print(f"To identify with them: --drive-gains {said}", markup=False, soft_wrap=True)
    for warning in found.warnings:
        console.print(f"! {warning}", markup=False)
