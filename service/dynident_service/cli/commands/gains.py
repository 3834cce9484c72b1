"""`dynident gains`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from dynident.errors import DynidentError
from dynident.identification.loads.known_load import KnownLoad
from dynident_service.cli.files import READABLE_FILE
from dynident_service.cli.options import (
    Json,
    Measurements,
    RobotArgument,
    RobotReading,
    file_option,
    repeatable_file_option,
)
from dynident_service.cli.request_options import RequestOptions, TypedValues

if TYPE_CHECKING:
    from rich.console import Console


def gains(
    robot: RobotArgument,
    measurements: Measurements,
    loaded: Annotated[
        list[Path],
        file_option("--loaded", help="Measurement of the same motion with the load; may be repeated."),
        READABLE_FILE,
    ],
    reading: RobotReading,
    weigh: Annotated[
        list[Path],
        repeatable_file_option(
            "--weigh", help="Measurement with another load, to be weighed with these gains; may be repeated."
        ),
        READABLE_FILE,
    ],
    weigh_unloaded: Annotated[
        list[Path],
        repeatable_file_option(
            "--weigh-unloaded", help="Of the motion of --weigh, without its load; else MEASUREMENT."
        ),
        READABLE_FILE,
    ],
    request_options: Annotated[TypedValues, RequestOptions(KnownLoad)],
    as_json: Json = False,
) -> None:
    """Identify the drive gains from runs without and with a load of known mass.

    MEASUREMENT are the runs without the load. With currents and no idea of the gains, say --drive-gains 1,1,….
    """
    from dynident.identification import identify_gains, payload_mass
    from dynident.progress import scale_progress
    from dynident_service.adapters.drive_gains import build_gain_tables, describe_gains
    from dynident_service.cli import inputs, output, terminal

    if weigh_unloaded and not weigh:
        raise DynidentError("nothing is to be weighed: give --weigh too", pointer="--weigh-unloaded")
    load = request_options.build_request(KnownLoad)
    if load.mass is None and not reading.metadata:
        raise DynidentError("say what the load weighs, in kg", pointer="--mass", title="Missing option")
    machine = inputs.load_robot_argument(robot, reading)
    # All files are read in one go, and are told apart by their places afterwards.
    others = [*loaded, *weigh, *weigh_unloaded]
    with inputs.read_recordings("gains", measurements, machine, reading, others, share=0.6) as data:
        unloaded, rest = data.recordings, data.other_recordings
        heavy = [
            replace(recording, payload=load.override_payload(recording.payload)) for recording in rest[: len(loaded)]
        ]
        drive_gains = identify_gains(machine, unloaded, heavy, progress=scale_progress(data.progress, 0.0, 0.75))
        other, bare = rest[len(loaded) :][: len(weigh)], rest[len(loaded) + len(weigh) :]
        loads = [
            (recording.name, payload_mass(machine, bare or unloaded, recording, gains=drive_gains))
            for recording in other
        ]
        data.progress(1.0, "solved")
    described = describe_gains(machine, drive_gains, [(name, name, load) for name, load in loads])
    gains_text = ",".join(f"{value:.4g}" for value in drive_gains.values)

    def print_gains(console: Console) -> None:
        terminal.print_tables(console, build_gain_tables(described))
        console.print(f"To identify with them: --drive-gains {gains_text}", soft_wrap=True)
        for warning in drive_gains.warnings:
            console.print(f"! {warning}")

    output.print_result(as_json, lambda: described, print_gains)
