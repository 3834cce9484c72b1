"""`dynident gains` (drive gains by a known payload) and `dynident currents` (without gains)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from dynident.errors import DynidentError
from dynident.identification.loads.drive_gain_request import KnownLoad
from dynident_cli.input_checks_and_writes import READABLE_FILE
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

    from dynident.identification import CurrentModel
    from dynident_cli.argument_loading import LoadedRecording


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
    from dynident_cli import argument_loading, command_output, printed_results
    from dynident_service.drive_gains.wire_types import CurrentModelsResult
    from dynident_service.shared.field_by_field import to_view as in_contract

    machine = argument_loading.load_robot_argument(robot, reading)
    unknown = all(drive.gain is None for drive in machine.drives)
    if unknown:
        # Then "torque" is the current itself.
        machine = argument_loading.with_gains(machine, ",".join("1" * machine.n))
    chosen_effects = argument_loading.read_effects(effects, machine) or PLAIN_EFFECTS
    with argument_loading.read_recordings("currents", measurements, machine, reading, validation) as data:
        training, held_out = data.recordings, data.other_recordings
        models = identify_currents(machine, training, held_out, effects=chosen_effects, progress=data.progress)
    checked = (
        (_without_scale_checks(data.loaded), _without_scale_checks(data.others))
        if unknown
        else (data.loaded, data.others)
    )

    def print_models(console: Console) -> None:
        printed_results.show_measurements(console, *checked)
        _print_current_models(console, models)

    command_output.write_result(
        result, "parameters", lambda: in_contract(CurrentModelsResult, None, joints=models), print_models
    )


def _without_scale_checks(measurements: Sequence[LoadedRecording]) -> list[LoadedRecording]:
    """Return recordings without the check of the torque's scale, which currents in place of torques have to fail."""
    return [
        replace(measurement, checks=tuple(check for check in measurement.checks if check.name != "torque_scale"))
        for measurement in measurements
    ]


def _print_current_models(console: Console, models: Sequence[CurrentModel]) -> None:
    from dynident.number_format import format_estimate, format_number, format_percent
    from dynident.presentation.labels import PARAMETER_JUDGEMENTS
    from dynident_cli import terminal

    rows = [
        [
            model.joint,
            str(len(model.parameters)),
            format_number(model.fit.rms_total, 3),
            format_percent(model.fit.relative_total),
            "–" if model.held_out is None else format_number(model.held_out.rms_total, 3),
            "–" if model.held_out is None else format_percent(model.held_out.relative_total),
        ]
        for model in models
    ]
    heads = ("joint", "parameters", "residual, A", "of the current", "held out, A", "of the current")
    console.print(terminal.build_table("The current of every joint", heads, rows))
    for model in models:
        parameter_rows = [
            [
                p.name,
                *format_estimate(p.value, 0.5 * (p.interval[1] - p.interval[0])),
                p.unit,
                PARAMETER_JUDGEMENTS[p.judgement].words,
            ]
            for p in model.parameters
        ]
        console.print(
            terminal.build_table(model.joint, ("parameter", "value", "± 95 %", "unit", "judgement"), parameter_rows)
        )


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
            "--weigh", help="Measurement with another load, whose mass is computed with these gains; may be repeated."
        ),
        READABLE_FILE,
    ],
    weigh_unloaded: Annotated[
        list[Path],
        repeatable_file_option(
            "--weigh-unloaded", help="Measurement of the motion of --weigh without its load; MEASUREMENT by default."
        ),
        READABLE_FILE,
    ],
    request_options: Annotated[TypedValues, RequestOptions(KnownLoad)],
    as_json: Json = False,
) -> None:
    """Identify drive gains from a load of known mass.

    MEASUREMENT are the runs without the load. If they have currents with unknown gains, give --drive-gains 1,1,….
    """
    from dynident.identification import identify_gains, payload_mass
    from dynident.progress import scale_progress
    from dynident_cli import argument_loading, command_output, terminal
    from dynident_service.drive_gains.adapters import build_gain_tables, describe_gains

    if weigh_unloaded and not weigh:
        raise DynidentError("there is no load to weigh; give --weigh, too", pointer="--weigh-unloaded")
    load = request_options.build_request(KnownLoad)
    if load.mass is None and not reading.metadata:
        raise DynidentError("the mass of the load is missing; give it in kg", pointer="--mass", title="Missing option")
    machine = argument_loading.load_robot_argument(robot, reading)
    # All files are read in one go, and are told apart by their places afterwards.
    others = [*loaded, *weigh, *weigh_unloaded]
    with argument_loading.read_recordings("gains", measurements, machine, reading, others, share=0.6) as data:
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

    command_output.print_result(as_json, lambda: described, print_gains)
