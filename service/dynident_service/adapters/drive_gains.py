"""Drive gains between the contract and the science."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dynident.identification import DriveGains, PayloadEstimate
from dynident.robot import Robot
from dynident_service.adapters.identifications import finite
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
    return wire.DriveGainsResult(
        gains=[_gain(robot, found, index) for index in range(robot.n)],
        loads=[_load(*one) for one in loads],
        warnings=[*found.warnings, *warnings],
    )


def _gain(robot: Robot, found: DriveGains, index: int) -> wire.IdentifiedGain:
    low, high = found.intervals[index].tolist()
    return wire.IdentifiedGain(
        joint=found.joint_names[index],
        drive_gain=float(found.values[index]),
        standard_deviation=finite(found.standard_deviations[index]),
        interval=(finite(low), finite(high)),
        unit=_unit(robot, index),
        stated=float(found.stated[index]),
        factor=float(found.factors[index]),
        identifiable=found.identifiable[index],
    )


def _unit(robot: Robot, index: int) -> str:
    if robot.drives[index].gain is None:
        return "-"
    return "N m/A" if robot.joints[index].kind == "revolute" else "N/A"


def _load(measurement_id: str, name: str, weighed: PayloadEstimate) -> wire.WeighedLoad:
    low, high = weighed.interval
    return wire.WeighedLoad(
        measurement_id=measurement_id,
        name=name,
        mass=weighed.mass,
        standard_deviation=finite(weighed.standard_deviation),
        from_gains=finite(weighed.from_gains),
        interval=(finite(low), finite(high)),
        identifiable=weighed.identifiable,
    )
