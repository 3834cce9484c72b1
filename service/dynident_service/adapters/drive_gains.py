"""Drive gains between the contract and the science."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.identification import DriveGains, PayloadEstimate
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


def _unit(robot: Robot, index: int) -> str:
    if robot.drives[index].gain is None:
        return "-"
    return "N m/A" if robot.joints[index].kind == "revolute" else "N/A"
