"""Views of drive gains, and of loads weighed with them."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.identification import DriveGains, PayloadEstimate
from dynident.presentation.model_tables import get_gain_unit
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
        to_view(wire.IdentifiedGain, gain, unit=get_gain_unit(robot, index))
        for index, gain in enumerate(drive_gains.each)
    ]
    weighed = [
        to_view(wire.WeighedLoad, load, measurement_id=measurement_id, name=name)
        for measurement_id, name, load in loads
    ]
    return wire.DriveGainsResult(gains=gains, loads=weighed, warnings=[*drive_gains.warnings, *warnings])
