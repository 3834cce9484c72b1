"""`dynident gains`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from dynident.errors import DynidentError
from dynident.identification.loads.known import KnownLoad
from dynident_service.cli.asked import Asks, Typed
from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import Json, Measurements, RobotArgument, RobotReading, of_file, several_files

if TYPE_CHECKING:
    from rich.console import Console

    from dynident.identification import DriveGains as Gains
    from dynident.identification import PayloadEstimate


def gains(
    robot: RobotArgument,
    measurements: Measurements,
    loaded: Annotated[
        list[Path],
        of_file("--loaded", help="Measurement of the same motion with the load; may be repeated."),
        TO_READ,
    ],
    reading: RobotReading,
    weigh: Annotated[
        list[Path],
        several_files(
            "--weigh", help="Measurement with another load, to be weighed with these gains; may be repeated."
        ),
        TO_READ,
    ],
    weigh_unloaded: Annotated[
        list[Path],
        several_files("--weigh-unloaded", help="Of the motion of --weigh, without its load; else MEASUREMENT."),
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
    from dynident_service.adapters.drive_gains import describe_gains
    from dynident_service.cli import inputs, telling

    if weigh_unloaded and not weigh:
        raise DynidentError("nothing is to be weighed: give --weigh too", pointer="--weigh-unloaded")
    load = asked.request(KnownLoad)
    if load.mass is None and not reading.metadata:
        raise DynidentError("say what the load weighs, in kg", pointer="--mass", title="Missing option")
    machine = inputs.robot_of(robot, reading)
    others = [*loaded, *weigh, *weigh_unloaded]
    with inputs.read("gains", measurements, machine, reading, others, share=0.6) as read:
        unloaded, rest = read.recordings, read.other_recordings
        heavy = [replace(recording, payload=load.over(recording.payload)) for recording in rest[: len(loaded)]]
        found = identify_gains(machine, unloaded, heavy, progress=part(read.progress, 0.0, 0.75))
        other, bare = rest[len(loaded) :][: len(weigh)], rest[len(loaded) + len(weigh) :]
        loads = [(one.name, payload_mass(machine, bare or unloaded, one, gains=found)) for one in other]
        read.progress(1.0, "solved")
    named = [(name, name, load) for name, load in loads]
    telling.say(as_json, lambda: describe_gains(machine, found, named), lambda console: _show(console, found, loads))


def _show(console: Console, found: Gains, loads: Sequence[tuple[str, PayloadEstimate]]) -> None:
    from dynident.reports.numbers import estimate, number
    from dynident_service.cli import terminal

    rows = [
        [name, number(stated, 4), *estimate(value, 1.96 * deviation), "yes" if known else "no"]
        for name, stated, value, deviation, known in zip(
            found.joint_names, found.stated, found.values, found.standard_deviations, found.identifiable, strict=True
        )
    ]
    console.print(terminal.table("", ("joint", "stated", "gain", "± 95 %", "identifiable"), rows))
    said = ",".join(f"{value:.4g}" for value in found.values)
    console.print(f"To identify with them: --drive-gains {said}", soft_wrap=True)
    if loads:
        weighed = [
            [name, *estimate(load.mass, 1.96 * load.standard_deviation), "yes" if load.identifiable else "no"]
            for name, load in loads
        ]
        console.print(terminal.table("", ("load", "kg", "± 95 %", "shows at all"), weighed))
    for warning in found.warnings:
        console.print(f"! {warning}")
