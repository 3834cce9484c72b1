"""`dynident gains`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident.errors import DynidentError
from dynident.identification.loads.known import KnownLoad
from dynident_service.cli.asked import Asks, Typed
from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import Json, Measurements, RobotArgument, RobotReading, several

if TYPE_CHECKING:
    pass


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
        TO_READ,
    ],
    reading: RobotReading,
    weigh: Annotated[
        list[Path],
        several(
            "--weigh",
            metavar="FILE",
            help="Measurement with another load, to be weighed with these gains; may be repeated.",
        ),
        TO_READ,
    ],
    weigh_unloaded: Annotated[
        list[Path],
        several(
            "--weigh-unloaded",
            metavar="FILE",
            help="Of the motion of --weigh, without its load; else MEASUREMENT.",
        ),
        TO_READ,
    ],
    asked: Annotated[Typed, Asks(KnownLoad)],
    as_json: Json = False,
) -> None:
    """Identify the drive gains from runs without and with a load of known mass.

    MEASUREMENT are the runs without the load. With currents and no idea of the gains, say --drive-gains 1,1,….
    """
    from dynident.identification import identify_gains, payload_mass
    from dynident.progress import part
    from dynident_service.adapters.drive_gains import describe_gains, gain_tables
    from dynident_service.cli import inputs, terminal
    from dynident_service.models.common import plain

    if weigh_unloaded and not weigh:
        raise DynidentError("nothing is to be weighed: give --weigh too", pointer="--weigh-unloaded")
    load = asked.request(KnownLoad)
    if load.mass is None and not reading.metadata:
        raise DynidentError("say what the load weighs, in kg", pointer="--mass", title="Missing option")
    machine = inputs.robot_of(robot, reading)
    with (
        terminal.progress_bar("gains") as progress,
        inputs.loaded(measurements, machine, reading, part(progress, 0.0, 0.6), [*loaded, *weigh, *weigh_unloaded]) as (
            without,
            others,
        ),
    ):
        unloaded, rest = inputs.recordings_of(without), inputs.recordings_of(others)
        heavy = [replace(recording, payload=load.over(recording.payload)) for recording in rest[: len(loaded)]]
        found = identify_gains(machine, unloaded, heavy, progress=part(progress, 0.6, 0.9))
        other, bare = rest[len(loaded) :][: len(weigh)], rest[len(loaded) + len(weigh) :]
        loads = [(one.name, payload_mass(machine, bare or unloaded, one, gains=found)) for one in other]
        progress(1.0, "solved")
    described = describe_gains(machine, found, [(name, name, load) for name, load in loads])
    if as_json:
        terminal.print_json(plain(described))
        return
    console = terminal.out()
    terminal.print_tables(console, gain_tables(described))
    said = ",".join(f"{value:.4g}" for value in found.values)
    console.print(f"To identify with them: --drive-gains {said}", markup=False, soft_wrap=True)
    for warning in found.warnings:
        console.print(f"! {warning}", markup=False)
