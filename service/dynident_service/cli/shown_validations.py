"""Validations as tables for people."""

from __future__ import annotations

from rich.console import Console

from dynident.reports.numbers import number, percent
from dynident.robot import Robot
from dynident_service.cli.terminal import table
from dynident_service.models.identifications import ErrorsView
from dynident_service.models.validations import FilterTrialView, MethodView, ValidationResult

_MARKS = {"pass": "✓ pass", "fail": "✕ fail", "not_evaluated": "– not evaluated"}
_STYLES = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold"}


def show_validation(console: Console, found: ValidationResult, robot: Robot) -> None:
    """The verdict, its reason, and the figures behind it."""
    if found.measurements and found.total is not None:
        rows = [[one.name, *_relative(one.errors)] for one in found.measurements]
        if len(rows) > 1:
            rows.append(["all", *_relative(found.total)])
        columns = ("measurement", *robot.joint_names, "all joints")
        console.print(table("Relative torque error", columns, rows))
    if found.methods:
        _show_methods(console, found, robot)
    if found.simulations:
        rows = [
            [one.name, f"{one.duration:.1f} s", *(_relative(one.torque) if one.torque else ["–"] * (robot.n + 1))]
            for one in found.simulations
        ]
        columns = ("measurement", "simulated", *robot.joint_names, "all joints")
        console.print(table("Simulated against measured torque", columns, rows, right_from=1))
    if found.filters is not None:
        rows = [_trial(one, one == found.filters.chosen) for one in found.filters.trials]
        headings = ("position cut-off", "torque cut-off", "decimation", "parameter error", "bias", "")
        console.print(table("Filters, by simulating the identification", headings, rows, right_from=0))
    if found.payload is not None:
        rows = [
            [one.name, number(one.value), f"{_maybe(one.interval[0])} to {_maybe(one.interval[1])}", one.unit]
            for one in found.payload.parameters
        ]
        console.print(table("Load", ("parameter", "value", "95 % interval", "unit"), rows))
    console.print(_MARKS[found.verdict], style=_STYLES[found.verdict])
    console.print(found.reason, markup=False)


def _show_methods(console: Console, found: ValidationResult, robot: Robot) -> None:
    rows = [_method(one, robot) for one in found.methods]
    columns = ("method", *robot.joint_names, "all joints", "parameters, σ", "most in", "torque", "time")
    console.print(table("Methods on the same data: relative held-out error; distance from the first", columns, rows))
    for one in found.methods:
        if one.problem:
            console.print(f"  {one.method}: {one.problem}", markup=False)


def _method(one: MethodView, robot: Robot) -> list[str]:
    if one.held_out is None:
        return [one.method, *["–"] * (robot.n + 5)]
    return [
        one.method,
        *_relative(one.held_out),
        _maybe(one.distance_rms),
        one.farthest or "",
        "–" if one.torque_distance is None else percent(one.torque_distance),
        f"{one.seconds:.2g} s",
    ]


def _trial(one: FilterTrialView, chosen: bool) -> list[str]:
    used = one.preprocessing
    return [
        *("none" if value is None else f"{value:.3g} Hz" for value in (used.position_cutoff, used.torque_cutoff)),
        str(used.decimation),
        "–" if one.error is None else f"{one.error:.3%}",
        "–" if one.bias is None else f"{one.bias:.3%}",
        "smallest error" if chosen else one.problem or "",
    ]


def _relative(errors: ErrorsView) -> list[str]:
    return ["–" if value is None else percent(value) for value in [*errors.relative, errors.relative_total]]


def _maybe(value: float | None) -> str:
    return "–" if value is None else number(value)
