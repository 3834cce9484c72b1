"""`dynident currents`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from dynident_service.cli.options import Effects, Measurements, OutputOptions, RobotArgument, RobotReading, Validation

if TYPE_CHECKING:
    from rich.console import Console

    from dynident.identification import CurrentModel
    from dynident_service.cli.inputs import LoadedRecording


def currents(
    robot: RobotArgument,
    measurements: Measurements,
    reading: RobotReading,
    validation: Validation,
    effects: Effects,
    result: OutputOptions,
) -> None:
    """Identify what every joint's current is made of, without any drive gain.

    The parameters are in units of current; each joint has its own. --out writes them as JSON.
    """
    from dynident.identification import identify_currents
    from dynident.identification.loads.payload_data import PLAIN_EFFECTS
    from dynident_service.adapters.serialise import to_view as in_contract
    from dynident_service.cli import inputs, output, result_tables
    from dynident_service.models.current_models import CurrentModelsResult

    machine = inputs.load_robot_argument(robot, reading)
    unknown = all(drive.gain is None for drive in machine.drives)
    if unknown:
        # Then "torque" is the current itself.
        machine = inputs.with_gains(machine, ",".join("1" * machine.n))
    chosen_effects = inputs.read_effects(effects, machine) or PLAIN_EFFECTS
    with inputs.read_recordings("currents", measurements, machine, reading, validation) as data:
        training, held_out = data.recordings, data.other_recordings
        models = identify_currents(machine, training, held_out, effects=chosen_effects, progress=data.progress)
    checked = (
        (_without_scale_checks(data.loaded), _without_scale_checks(data.others))
        if unknown
        else (data.loaded, data.others)
    )

    def print_models(console: Console) -> None:
        result_tables.show_measurements(console, *checked)
        _print_current_models(console, models)

    output.write_result(
        result, "parameters", lambda: in_contract(CurrentModelsResult, None, joints=models), print_models
    )


def _without_scale_checks(measurements: Sequence[LoadedRecording]) -> list[LoadedRecording]:
    """Return recordings without the check of the torque's scale, which currents in place of torques have to fail."""
    return [
        replace(measurement, checks=tuple(check for check in measurement.checks if check.name != "torque_scale"))
        for measurement in measurements
    ]


def _print_current_models(console: Console, models: Sequence[CurrentModel]) -> None:
    from dynident.reports.labels import PARAMETER_JUDGEMENTS
    from dynident.reports.number_format import format_estimate, format_number, format_percent
    from dynident_service.cli import terminal

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
