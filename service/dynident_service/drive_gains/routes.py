"""Routes of drive gains, and of models in units of current."""

from __future__ import annotations

from fastapi import APIRouter

from dynident.errors import DynidentError
from dynident_service.drive_gains.wire_types import (
    CurrentModelsRequest,
    CurrentModelsView,
    DriveGainsRequest,
    DriveGainsResult,
    DriveGainsView,
)
from dynident_service.problems import make_unusable
from dynident_service.robots.wire_types import RobotResult
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import depend_on, refuse_coupled, require_measurements, require_robot
from dynident_service.shared.resource_routes import PagesDep, SubmissionDep, show_with_tables
from dynident_service.shared.wire_types import Page, Table
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/drive_gains", tags=["drive gains"])
GAINS = NewJob("drive_gains", "dynident_service.drive_gains.jobs:find_gains")
CURRENTS = NewJob("current_models", "dynident_service.drive_gains.jobs:find_currents")


def _build_tables(_: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident.presentation.model_tables import build_gain_tables
        from dynident_service.shared.field_by_field import show_tables

    result = DriveGainsResult.model_validate(resource.result)
    gains = ((g.joint, g.stated, g.drive_gain, g.interval, g.unit, g.identifiable) for g in result.gains)
    loads = ((load.name, load.mass, load.interval, load.from_gains, load.identifiable) for load in result.loads)
    return show_tables(build_gain_tables(gains, loads))


@router.post("", status_code=202)
def create_drive_gains(body: DriveGainsRequest, services: ServicesDep, submit: SubmissionDep) -> DriveGainsView:
    """Identify the drive gains from the same motion without and with a load of known mass."""
    robot = require_robot(services, body.robot_id)
    refuse_coupled(robot, "gains are identified only for")
    needs = (depend_on(robot), *_require_measurements(services, body, robot))
    _check_loads(services, body)
    return submit(DriveGainsView, "drive_gains", body, GAINS, needs)


@router.get("")
def list_drive_gains(pages: PagesDep, robot_id: str | None = None) -> Page[DriveGainsView]:
    """List the drive gains, newest first; those of one robot if requested."""
    return pages.show("drive_gains", DriveGainsView.show, robot_id)


@router.get("/{drive_gains_id}")
def get_drive_gains(drive_gains_id: str, services: ServicesDep) -> DriveGainsView:
    """Show drive gains, with the result once there is one."""
    return show_with_tables(DriveGainsView, services, "drive_gains", drive_gains_id, _build_tables)


@router.delete("/{drive_gains_id}", status_code=204)
def delete_drive_gains(drive_gains_id: str, services: ServicesDep) -> None:
    """Delete drive gains; the robot keeps those that it states."""
    services.resources.delete("drive_gains", drive_gains_id)


def _require_measurements(services: Services, body: DriveGainsRequest, robot: Resource) -> tuple[Dependency, ...]:
    """Find the runs, each without or with its load and not both."""
    if body.weigh is None and body.weigh_unloaded is not None:
        raise make_unusable("there is no load to weigh; give weigh, or leave weigh_unloaded out", "/weigh_unloaded")
    runs_without = body.unloaded if body.weigh_unloaded is None else body.weigh_unloaded
    for field, loaded, unloaded in (("loaded", body.loaded, body.unloaded), ("weigh", body.weigh or [], runs_without)):
        for index, identifier in enumerate(loaded):
            if identifier in unloaded:
                detail = f"the measurement {identifier!r} is also given as a run without the load"
                raise make_unusable(detail, f"/{field}/{index}")
    groups = (
        ("unloaded", body.unloaded),
        ("loaded", body.loaded),
        ("weigh", body.weigh or []),
        ("weigh_unloaded", body.weigh_unloaded or []),
    )
    return tuple(
        need for field, ids in groups for need in require_measurements(services, robot, ids, field, f"/{field}")
    )


def _check_loads(services: Services, body: DriveGainsRequest) -> None:
    """Refuse loads whose weight neither the request nor the measurement states."""
    with hold_import_lock():
        from dynident.identification.identification_choices import KnownLoad
        from dynident.identification.loads.payloads_of_recordings import parse_payload
        from dynident_service.shared.field_by_field import to_request

    load = to_request(body, KnownLoad)
    # Each is checked now: a job would find out only after minutes.
    for index, identifier in enumerate(body.loaded):
        measurement = services.resources.get("measurement", identifier)
        payload = load.override_payload(measurement.request.get("payload"))
        if "mass" not in (payload or {}):
            detail = f'{identifier!r} does not state "payload": {{"mass": …}}; give mass, in kg'
            raise make_unusable(detail, "/mass")
        try:
            parse_payload(measurement.name or identifier, payload)
        except DynidentError as error:
            raise make_unusable(error.detail, f"/loaded/{index}", title=error.title) from error


currents_router = APIRouter(prefix="/v1/current_models", tags=["current models"])


@currents_router.post("", status_code=202)
def create_current_models(
    body: CurrentModelsRequest, services: ServicesDep, submit: SubmissionDep
) -> CurrentModelsView:
    """Identify every joint's parameters in units of its current; no drive gain is needed."""
    with hold_import_lock():
        from dynident.identification.loads.current_models import check_current_effects
        from dynident.identification.shape_search import check_choices
        from dynident_service.robots.adapters import restore_robot
        from dynident_service.shared.field_by_field import from_wire_choices

    robot = require_robot(services, body.robot_id)
    _check_stated_gains(robot)
    refuse_coupled(robot, "currents are identified only for")
    effects = from_wire_choices(body.effects or [])
    check_choices(effects, restore_robot(robot.request))
    check_current_effects(effects)
    needs = (
        depend_on(robot),
        *require_measurements(services, robot, body.measurement_ids, "measurement", "/measurement_ids"),
        *require_measurements(services, robot, body.validation_ids, "validation", "/validation_ids"),
    )
    return submit(CurrentModelsView, "current_models", body, CURRENTS, needs)


@currents_router.get("")
def list_current_models(pages: PagesDep, robot_id: str | None = None) -> Page[CurrentModelsView]:
    """List the models of currents, newest first; those of one robot if requested."""
    return pages.show("current_models", CurrentModelsView.show, robot_id)


@currents_router.get("/{current_models_id}")
def get_current_models(current_models_id: str, services: ServicesDep) -> CurrentModelsView:
    """Show models of currents, with the result once there is one."""
    return CurrentModelsView.show(services.resources.get("current_models", current_models_id))


@currents_router.delete("/{current_models_id}", status_code=204)
def delete_current_models(current_models_id: str, services: ServicesDep) -> None:
    """Delete models of currents."""
    services.resources.delete("current_models", current_models_id)


def _check_stated_gains(robot: Resource) -> None:
    """Refuse a robot that does not state, be it wrongly, what its torques are in terms of currents."""
    joints_without_gain = [
        joint.name for joint in RobotResult.model_validate(robot.result).joints if joint.drive_gain is None
    ]
    if joints_without_gain:
        raise make_unusable(
            f"{', '.join(joints_without_gain)} of this robot state no drive gain, so its measurements contain "
            f'torques; make a robot with "drives": {{"…": {{"drive_gain": 1}}}} for each of them, and upload the '
            "currents for it",
            "/robot_id",
            title="No currents",
        )
