"""Check the resources that a request names (they exist, have succeeded, fit each other), and find their files."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from dynident_service.measurements.wire_types import ROWS
from dynident_service.problems import ProblemError, make_not_found, make_unusable
from dynident_service.robots.wire_types import JointView, RobotResult
from dynident_service.storage.repository_values import CHANGED, Dependency, Kind, OwnedObject, Resource
from dynident_service.storage.resource_repository import Resources

if TYPE_CHECKING:
    from dynident_service.storage_and_engine import Services

_LATEST = 20
"""Resources that are looked through for the newest one."""


class ResourceReader(Protocol):
    """Reads resources by their ids."""

    def find(self, identifier: str) -> Resource | None:
        """Read a resource of whatever kind."""

    def get(self, kind: Kind, identifier: str) -> Resource:
        """Read one resource; a problem 404 if there is none."""


class HasResources(Protocol):
    """The part of the services that a check of a request needs: its resources."""

    @property
    def resources(self) -> ResourceReader:
        """The resources."""


class PrefetchedResources:
    """Resources that are read with one query, before a batch asks for them one by one."""

    def __init__(self, resources: Resources, identifiers: Iterable[str]) -> None:
        self._resources = resources
        self._found: dict[str, Resource | None] = dict(resources.find_all(identifiers))

    @property
    def resources(self) -> ResourceReader:
        """Itself, so that it can stand in for the services."""
        return self

    def find(self, identifier: str) -> Resource | None:
        """Give a resource, read now if it was not before."""
        if identifier not in self._found:
            self._found[identifier] = self._resources.find(identifier)
        return self._found[identifier]

    def get(self, kind: Kind, identifier: str) -> Resource:
        """Give a resource of a kind; a problem 404 if there is none."""
        resource = self.find(identifier)
        if resource is None or resource.kind != kind:
            raise make_not_found(kind, identifier)
        return resource


def require_resource(services: HasResources, kind: Kind, identifier: str, pointer: str) -> Resource:
    """Find a resource that the request names."""
    resource = services.resources.find(identifier)
    if resource is None or resource.kind != kind:
        raise make_unusable(f"there is no {kind} {identifier!r}", pointer, title="Unknown resource")
    if is_under_way(resource):
        detail = f"the measurement {identifier!r} is under way; send its last rows with finished=true first"
        raise make_unusable(detail, pointer, title="Under way")
    return resource


def is_under_way(resource: Resource) -> bool:
    """Return whether a resource is a recording whose rows still come."""
    return bool((resource.result or {}).get("under_way"))


def find_original(measurement: Resource, otherwise: str = "original") -> OwnedObject:
    """Give the file of a measurement as it was uploaded, or the object of another role; 404 where there is none."""
    owned = measurement.objects.get("original") or measurement.objects.get(otherwise)
    if owned is None:
        raise make_not_found("file of measurement", measurement.id)
    return owned


def copy_original(services: Services, measurement: Resource, folder: Path) -> Path:
    """Copy the file of a measurement, or its rows so far, whose file is deleted when the next ones come."""
    copy = folder / "stored.parquet"
    try:
        shutil.copyfile(services.objects.fetch_file(find_original(measurement, ROWS).key), copy)
    except (FileNotFoundError, ProblemError) as error:
        now = services.resources.get("measurement", measurement.id)
        if now.objects == measurement.objects:
            raise
        raise ProblemError(409, "More rows have come meanwhile; try again.", title=CHANGED) from error
    return copy


def require_robot(services: HasResources, identifier: str) -> Resource:
    """Find the robot that the request names."""
    return require_resource(services, "robot", identifier, "/robot_id")


def require_result(
    services: HasResources, kind: Kind, identifier: str, pointer: str, title: str = "Unusable input"
) -> Resource:
    """Find a resource that the request names, and whose job must have succeeded."""
    resource = require_resource(services, kind, identifier, pointer)
    state = resource.job.state if resource.job is not None else "failed"
    if state != "succeeded":
        detail = f"the {kind} {identifier!r} is {state}; it must have succeeded"
        raise make_unusable(detail, pointer, title=title)
    return resource


def require_model(services: HasResources, identifier: str) -> Resource:
    """Find the identification that the request names; it must have succeeded."""
    return require_result(services, "identification", identifier, "/identification_id", "Not identified")


def require_model_of(services: HasResources, robot: Resource, identifier: str) -> Resource:
    """Find a model that the request names; it must be of a robot with the same joints."""
    model = require_model(services, identifier)
    other = services.resources.get("robot", model.get_dependency("robot"))
    own, others = ([joint.name for joint in RobotResult.model_validate(item.result).joints] for item in (robot, other))
    if own != others:
        detail = (
            f"the identification {identifier!r} is of a robot with the joints {', '.join(others)}; this robot has "
            f"{', '.join(own)}"
        )
        raise make_unusable(detail, "/identification_id", title="Model of another robot")
    return model


def require_design(services: HasResources, identifier: str, robot: Resource) -> Dependency:
    """Return the dependency on a design; it must be computed, and for this robot."""
    design = require_result(services, "design", identifier, "/design_id")
    if design.get_dependency("robot") != robot.id:
        detail = f"the design {identifier!r} is for another robot, {design.get_dependency('robot')}"
        raise make_unusable(detail, "/design_id")
    return Dependency(identifier, "design", "design", "/design_id")


def depend_on(resource: Resource) -> Dependency:
    """Return the dependency on a robot or a model that the request names by the id of its kind."""
    return Dependency(resource.id, resource.kind, resource.kind, f"/{resource.kind}_id")


def find_newest(resources: Resources, kind: Kind, on_id: str) -> Resource | None:
    """Find the newest resource of a kind that depends on another one, and whose job has not failed."""
    for resource in resources.list_page(kind, _LATEST, on_id=on_id).items:
        if resource.job is not None and resource.job.state not in ("failed", "cancelled"):
            return resource
    return None


def add_next_experiment(resources: Resources, diagnosis: Resource) -> Resource:
    """Return a stored diagnosis with the next experiment that was found since, if there is one."""
    search = find_newest(resources, "next_experiment", diagnosis.id)
    experiment = search.result.get("experiment") if search is not None and search.result is not None else None
    if diagnosis.result is None or experiment is None:
        return diagnosis
    return replace(diagnosis, result={**diagnosis.result, "next_experiment": experiment})


def require_measurements(
    services: HasResources, robot: Resource, identifiers: Sequence[str], role: str, pointer: str
) -> tuple[Dependency, ...]:
    """Find the measurements that the request names; they must be of this robot, or of one with the same drives."""
    needs = []
    for index, identifier in enumerate(identifiers):
        item_pointer = f"{pointer}/{index}"
        measurement = require_resource(services, "measurement", identifier, item_pointer)
        if identifier in identifiers[:index]:
            raise make_unusable(f"the measurement {identifier!r} is given twice", item_pointer)
        require_same_drives(services, robot, measurement, item_pointer)
        needs.append(Dependency(identifier, "measurement", role, item_pointer))
    return tuple(needs)


def require_same_drives(services: HasResources, robot: Resource, measurement: Resource, pointer: str) -> None:
    """Refuse a measurement whose torques were computed with other drive gains, or of other joints."""
    own = measurement.get_dependency("robot")
    if own == robot.id:
        return
    other = services.resources.get("robot", own)
    # Measurements are stored as torques: they rest on the gains of the robot that they were uploaded for.
    if _list_drives(robot) != _list_drives(other):
        detail = (
            f"the measurement {measurement.id!r} is of the robot {other.name!r} ({own}), which has other joints or "
            f"drive gains; upload its file for the robot {robot.id}"
        )
        raise make_unusable(detail, pointer, title="Another robot's measurement")


def refuse_coupled(robot: Resource, reason: str) -> None:
    """Refuse a robot of which a motor acts on several joints."""
    coupled = [joint.name for joint in RobotResult.model_validate(robot.result).joints if joint.coupling]
    if coupled:
        raise make_unusable(
            f"the motors of {', '.join(coupled)} of this robot act on several joints; {reason} motors that act on "
            "one joint each",
            "/robot_id",
            title="Coupled drives",
        )


def _list_drives(robot: Resource) -> list[tuple[str, str, float | None, dict[str, float]]]:
    joints: list[JointView] = RobotResult.model_validate(robot.result).joints
    return [(joint.name, joint.type, joint.drive_gain, joint.coupling) for joint in joints]


def get_joints_and_units(services: HasResources, resource: Resource) -> tuple[list[str], list[str]]:
    """Return the names of the joints of the model that a resource is about, and the units of their torques."""
    model = services.resources.get("identification", resource.get_dependency("identification"))
    return ([], []) if model.result is None else (model.result["joints"], model.result["effort_units"])
