"""Drive gains between the contract and the science."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf

from dynident.identification import DriveGains, PayloadEstimate
from dynident.reports.numbers import estimate
from dynident.reports.tables import Cell, ReportedTable, figure, interval, words
from dynident.robot import Robot
from dynident_service.adapters.answers import shown
from dynident_service.models import drive_gains as wire


def describe_gains(
    robot: Robot,
    found: DriveGains,
    loads: Sequence[tuple[str, str, PayloadEstimate]] = (),
    warnings: Sequence[str] = (),
) -> wire.DriveGainsResult:
    """Describe gains for the wire, with the loads (measurement's id and name) weighed with them."""
    gains = [shown(wire.IdentifiedGain, one, unit=_unit(robot, index)) for index, one in enumerate(found.each)]
    weighed = [shown(wire.WeighedLoad, load, measurement_id=one, name=name) for one, name, load in loads]
    return wire.DriveGainsResult(gains=gains, loads=weighed, warnings=[*found.warnings, *warnings])


def gain_tables(found: wire.DriveGainsResult) -> Iterator[ReportedTable]:
    """The gains, and the loads weighed with them."""
    gains = tuple(
        (
            Cell(one.joint),
            figure(one.stated, 4),
            *_within(one.drive_gain, one.interval),
            Cell("factor" if one.unit == "-" else one.unit),
            Cell("✓ yes", mark="ok") if one.identifiable else Cell("✕ no", mark="error"),
        )
        for one in found.gains
    )
    yield ReportedTable("Drive gains", ("joint", "stated", "identified", "± 95 %", "unit", "identifiable"), gains)
    if found.loads:
        loads = tuple(
            (
                Cell(one.name),
                *_within(one.mass, one.interval),
                interval(one.interval),
                figure(one.from_gains, 2),
                *words("yes" if one.identifiable else "no"),
            )
            for one in found.loads
        )
        columns = ("measurement", "mass", "± 95 %", "95 % interval", "σ from the gains", "shows at all")
        yield ReportedTable("Loads weighed with these gains, kg", columns, loads)


def _within(value: float, ends: tuple[float | None, float | None]) -> tuple[Cell, Cell]:
    """A value, and half of its interval, with as many digits as that has."""
    low, high = ends
    half = None if low is None or high is None else (high - low) / 2.0
    told = estimate(value, inf if half is None else half)
    return Cell(told[0], value), Cell(told[1], half)


def _unit(robot: Robot, index: int) -> str:
    if robot.drives[index].gain is None:
        return "-"
    return "N m/A" if robot.joints[index].kind == "revolute" else "N/A"
