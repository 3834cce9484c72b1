"""Drive gains between the contract and the science."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dynident.identification import DriveGains, PayloadEstimate
from dynident.robot import Robot
from dynident_service.adapters.answers import shown
from dynident_service.models import drive_gains as wire


def stated_load(request: wire.DriveGainsRequest, own: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """What is stated of a loaded measurement's payload: by itself, or over that by the request."""
    said = {"mass": request.mass, "centre": request.centre}
    given = {name: value for name, value in said.items() if value is not None}
    return own if not given else {**(own or {}), **given}


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
