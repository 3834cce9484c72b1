"""Views and tables of drive gains, and of loads weighed with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf

from dynident.identification import DriveGains, PayloadEstimate
from dynident.number_format import format_estimate
from dynident.presentation.tables import (
    Cell,
    ReportedTable,
    make_interval_cell,
    make_number_cell,
    make_text_cells,
)
from dynident.robot import Robot
from dynident_service.drive_gains import wire_types as wire
from dynident_service.shared.field_by_field import to_view


def describe_gains(
    robot: Robot,
    drive_gains: DriveGains,
    loads: Sequence[tuple[str, str, PayloadEstimate]] = (),
    warnings: Sequence[str] = (),
) -> wire.DriveGainsResult:
    """Build the view of drive gains, and of loads weighed with them (id and name of the measurement, estimate)."""
    gains = [
        to_view(wire.IdentifiedGain, gain, unit=_gain_unit(robot, index)) for index, gain in enumerate(drive_gains.each)
    ]
    weighed = [
        to_view(wire.WeighedLoad, load, measurement_id=measurement_id, name=name)
        for measurement_id, name, load in loads
    ]
    return wire.DriveGainsResult(gains=gains, loads=weighed, warnings=[*drive_gains.warnings, *warnings])


def build_gain_tables(result: wire.DriveGainsResult) -> Iterator[ReportedTable]:
    """Yield the table of gains and the table of weighed loads."""
    gains = tuple(
        (
            Cell(gain.joint),
            make_number_cell(gain.stated, 4),
            *_value_cells(gain.drive_gain, gain.interval),
            Cell("factor" if gain.unit == "-" else gain.unit),
            Cell("✓ yes", mark="ok") if gain.identifiable else Cell("✕ no", mark="error"),
        )
        for gain in result.gains
    )
    yield ReportedTable("Drive gains", ("joint", "stated", "identified", "± 95 %", "unit", "identifiable"), gains)
    if result.loads:
        loads = tuple(
            (
                Cell(load.name),
                *_value_cells(load.mass, load.interval),
                make_interval_cell(load.interval),
                make_number_cell(load.from_gains, 2),
                *make_text_cells("yes" if load.identifiable else "no"),
            )
            for load in result.loads
        )
        columns = ("measurement", "mass", "± 95 %", "95 % interval", "σ from the gains", "not zero")
        yield ReportedTable("Loads weighed with these gains, kg", columns, loads)


def _value_cells(value: float, ends: tuple[float | None, float | None]) -> tuple[Cell, Cell]:
    """Return the cells of a value and of half its interval; the interval decides the digits."""
    low, high = ends
    # An end that is null is infinite: then there is no half to show.
    half = None if low is None or high is None else (high - low) / 2.0
    texts = format_estimate(value, inf if half is None else half)
    return Cell(texts[0], value), Cell(texts[1], half)


def _gain_unit(robot: Robot, index: int) -> str:
    # Without a stated gain the recorded torque is multiplied by a factor, which has no unit.
    if robot.drives[index].gain is None:
        return "-"
    return "N m/A" if robot.joints[index].kind == "revolute" else "N/A"
