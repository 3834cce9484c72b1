"""What a request names must be there, and fit."""

from __future__ import annotations

from collections.abc import Sequence

from dynident_service.models.robots import JointView, RobotResult
from dynident_service.problems import unusable
from dynident_service.services import Services
from dynident_service.storage.records import Kind, Resource, RestsOn


def needed(services: Services, kind: Kind, identifier: str, pointer: str) -> Resource:
    """Find a resource that the request names."""
    found = services.resources.find(identifier)
    if found is None or found.kind != kind:
        raise unusable(f"there is no {kind} {identifier!r}", pointer, title="Unknown resource")
    return found


def needed_robot(services: Services, identifier: str) -> Resource:
    """Find the robot that the request names."""
    return needed(services, "robot", identifier, "/robot_id")


def needed_model(services: Services, identifier: str) -> Resource:
    """Find the identification that the request names; it must have succeeded."""
    found = needed(services, "identification", identifier, "/identification_id")
    state = found.job.state if found.job is not None else "failed"
    if state != "succeeded":
        detail = f"the identification {identifier!r} is {state}; one that succeeded is needed"
        raise unusable(detail, "/identification_id", title="Not identified")
    return found


def needed_measurements(
    services: Services, robot: Resource, identifiers: Sequence[str], role: str, pointer: str
) -> tuple[RestsOn, ...]:
    """Find the measurements that the request names; they must be of this robot, or of one with the same drives."""
    found = []
    for index, identifier in enumerate(identifiers):
        at = f"{pointer}/{index}"
        measurement = needed(services, "measurement", identifier, at)
        if identifier in identifiers[:index]:
            raise unusable(f"the measurement {identifier!r} is named twice", at)
        require_same_drives(services, robot, measurement, at)
        found.append(RestsOn(identifier, "measurement", role, at))
    return tuple(found)


def require_same_drives(services: Services, robot: Resource, measurement: Resource, pointer: str) -> None:
    """Refuse a measurement whose torques were computed with other drive gains, or of other joints."""
    own = measurement.one("robot")
    if own == robot.id:
        return
    other = services.resources.get("robot", own)
    if _drives(robot) != _drives(other):
        detail = (
            f"the measurement {measurement.id!r} is of the robot {other.name!r} ({own}), which has other joints or "
            f"drive gains; upload its file for the robot {robot.id}"
        )
        raise unusable(detail, pointer, title="Another robot's measurement")


def _drives(robot: Resource) -> list[tuple[str, str, float | None, dict[str, float]]]:
    joints: list[JointView] = RobotResult.model_validate(robot.result).joints
    return [(joint.name, joint.type, joint.drive_gain, joint.coupling) for joint in joints]
