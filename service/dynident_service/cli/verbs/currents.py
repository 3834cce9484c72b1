"""`dynident currents`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from dynident_service.cli.options import Effects, Measurements, Result, RobotArgument, RobotReading, Validation

if TYPE_CHECKING:
    from rich.console import Console

    from dynident.identification import CurrentModel
    from dynident_service.cli.inputs import Loaded


def currents(
    robot: RobotArgument,
    measurements: Measurements,
    reading: RobotReading,
    validation: Validation,
    effects: Effects,
    result: Result,
) -> None:
    """Identify what every joint's current is made of, without any drive gain.

    The parameters are in units of current; each joint has its own. --out writes them as JSON.
    """
    from dynident.identification import identify_currents
    from dynident.identification.loads.payloads import PLAIN_EFFECTS
    from dynident_service.adapters.answers import shown as in_contract
    from dynident_service.cli import inputs, shown, telling
    from dynident_service.models.current_models import CurrentModelsResult

    machine = inputs.robot_of(robot, reading)
    unknown = all(drive.gain is None for drive in machine.drives)
    if unknown:
        # Then "torque" is the current itself.
        machine = inputs.with_gains(machine, ",".join("1" * machine.n))
    chosen = inputs.effects_of(effects, machine) or PLAIN_EFFECTS
    with inputs.read("currents", measurements, machine, reading, validation) as read:
        training, held_out = read.recordings, read.other_recordings
        found = identify_currents(machine, training, held_out, effects=chosen, progress=read.progress)
    checked = (_unscaled(read.given), _unscaled(read.others)) if unknown else (read.given, read.others)

    def show(console: Console) -> None:
        shown.show_measurements(console, *checked)
        _show(console, found)

    telling.tell(result, "parameters", lambda: in_contract(CurrentModelsResult, None, joints=found), show)


def _unscaled(measurements: Sequence[Loaded]) -> list[Loaded]:
    """Without the check of the torque's scale, which currents in place of torques have to fail."""
    return [
        replace(one, checks=tuple(check for check in one.checks if check.name != "torque_scale"))
        for one in measurements
    ]


def _show(console: Console, found: Sequence[CurrentModel]) -> None:
    from dynident.reports.numbers import estimate, number, percent
    from dynident.reports.words import JUDGED
    from dynident_service.cli import terminal

    rows = [
        [
            one.joint,
            str(len(one.parameters)),
            number(one.fit.rms_total, 3),
            percent(one.fit.relative_total),
            "–" if one.held_out is None else number(one.held_out.rms_total, 3),
            "–" if one.held_out is None else percent(one.held_out.relative_total),
        ]
        for one in found
    ]
    heads = ("joint", "parameters", "residual, A", "of the current", "held out, A", "of the current")
    console.print(terminal.table("The current of every joint", heads, rows))
    for one in found:
        told = [
            [p.name, *estimate(p.value, 0.5 * (p.interval[1] - p.interval[0])), p.unit, JUDGED[p.judgement].words]
            for p in one.parameters
        ]
        console.print(terminal.table(one.joint, ("parameter", "value", "± 95 %", "unit", "judgement"), told))
