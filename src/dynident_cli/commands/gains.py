"""`dynident gains` (drive gains by a known payload) and `dynident currents` (without gains)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from dynident.errors import DynidentError
from dynident.identification.identification_choices import KnownLoad
from dynident_cli.option_parsers import READABLE_FILE
from dynident_cli.request_options import RequestOptions, TypedValues
from dynident_cli.shared_options import (
    Effects,
    Json,
    Measurements,
    OutputOptions,
    RobotArgument,
    RobotReading,
    Validation,
    file_option,
    repeatable_file_option,
)

if TYPE_CHECKING:
    from rich.console import Console

    from dynident.api.recording_collection import Recordings


def currents(
    robot: RobotArgument,
    measurements: Measurements,
    reading: RobotReading,
    validation: Validation,
    effects: Effects,
    result: OutputOptions,
) -> None:
    """Identify a model of every joint's current. It needs no drive gains.

    The parameters are in units of current, separate for each joint. --out writes them as JSON.
    """
    from dynident.identification import identify_currents
    from dynident.identification.loads.payloads_of_recordings import PLAIN_EFFECTS
    from dynident.presentation.model_tables import build_current_tables
    from dynident_cli import argument_loading, command_output, contract_documents, printed_results

    machine = argument_loading.load_robot_argument(robot, reading)
    unknown = all(drive.gain is None for drive in machine.drives)
    if unknown:
        # Then "torque" is the current itself.
        machine = argument_loading.with_gains(machine, ",".join("1" * machine.n))
    chosen_effects = argument_loading.read_effects(effects, machine) or PLAIN_EFFECTS
    with argument_loading.read_recordings("currents", measurements, machine, reading, validation) as data:
        training, held_out, progress = data
        models = identify_currents(
            machine, training.recordings, held_out.recordings, effects=chosen_effects, progress=progress
        )
    checked = [_without_scale_checks(items) if unknown else items for items in (training, held_out)]

    def print_models(console: Console) -> None:
        printed_results.show_measurements(console, *checked)
        command_output.print_tables(console, build_current_tables(models))

    command_output.write_result(
        result, "parameters", lambda: contract_documents.describe_currents(models), print_models
    )


def _without_scale_checks(recordings: Recordings) -> Recordings:
    """Return recordings without the check of the torque's scale, which currents in place of torques have to fail."""
    return type(recordings)(
        tuple(
            replace(item, checks=tuple(check for check in item.checks if check.name != "torque_scale"))
            for item in recordings
        )
    )


def gains(
    robot: RobotArgument,
    measurements: Measurements,
    loaded: Annotated[
        list[Path],
        file_option("--loaded", help="Recording of the same motion with the load; may be repeated."),
        READABLE_FILE,
    ],
    reading: RobotReading,
    weigh: Annotated[
        list[Path],
        repeatable_file_option(
            "--weigh", help="Recording with another load, whose mass is computed with these gains; may be repeated."
        ),
        READABLE_FILE,
    ],
    weigh_unloaded: Annotated[
        list[Path],
        repeatable_file_option(
            "--weigh-unloaded", help="Recording of the motion of --weigh without its load; RECORDING by default."
        ),
        READABLE_FILE,
    ],
    request_options: Annotated[TypedValues, RequestOptions(KnownLoad)],
    as_json: Json = False,
) -> None:
    """Identify drive gains from a load of known mass.

    RECORDING is the motion without the load. If it contains currents with unknown gains, give --drive-gains 1,1,….
    """
    from dynident.identification import identify_gains, payload_mass
    from dynident.presentation.model_tables import build_gain_tables, get_gain_unit
    from dynident.progress import scale_progress
    from dynident_cli import argument_loading, command_output, contract_documents

    if weigh_unloaded and not weigh:
        raise DynidentError("there is no load to weigh; give --weigh, too", pointer="--weigh-unloaded")
    load = request_options.build_request(KnownLoad)
    if load.mass is None and not reading.metadata:
        raise DynidentError("the mass of the load is missing; give it in kg", pointer="--mass", title="Missing option")
    machine = argument_loading.load_robot_argument(robot, reading)
    # All files are read in one go, and are told apart by their places afterwards.
    others = [*loaded, *weigh, *weigh_unloaded]
    with argument_loading.read_recordings("gains", measurements, machine, reading, others, share=0.6) as data:
        unloaded, rest, progress = data[0].recordings, data[1].recordings, data[2]
        heavy = [
            replace(recording, payload=load.override_payload(recording.payload)) for recording in rest[: len(loaded)]
        ]
        drive_gains = identify_gains(machine, unloaded, heavy, progress=scale_progress(progress, 0.0, 0.75))
        other, bare = rest[len(loaded) :][: len(weigh)], rest[len(loaded) + len(weigh) :]
        loads = [
            (recording.name, payload_mass(machine, bare or unloaded, recording, gains=drive_gains))
            for recording in other
        ]
        progress(1.0, "solved")
    gains_text = ",".join(f"{value:.4g}" for value in drive_gains.values)

    def print_gains(console: Console) -> None:
        units = [get_gain_unit(machine, index, drive_gains.from_commands) for index in range(machine.n)]
        gains = (
            (gain.joint, gain.stated, gain.drive_gain, gain.interval, unit, gain.identifiable)
            for gain, unit in zip(drive_gains.each, units, strict=True)
        )
        weighed = ((name, load.mass, load.interval, load.from_gains, load.identifiable) for name, load in loads)
        command_output.print_tables(console, build_gain_tables(gains, weighed))
        console.print(f"To identify with them: --drive-gains {gains_text}", soft_wrap=True)
        for warning in drive_gains.warnings:
            console.print(f"! {warning}")

    command_output.print_result(
        as_json, lambda: contract_documents.describe_gains(machine, drive_gains, loads), print_gains
    )
