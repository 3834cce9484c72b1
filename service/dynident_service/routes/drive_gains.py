"""Routes of drive gains."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter

from dynident.errors import DynidentError
from dynident_service.problems import make_unusable
from dynident_service.routes.required_resources import depend_on, refuse_coupled, require_measurements, require_robot
from dynident_service.routes.resource_routes import ResourceRoutes, add_create_route
from dynident_service.science_preload import hold_import_lock
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services
from dynident_service.wire_types.drive_gains import DriveGainsRequest, DriveGainsResult, DriveGainsView
from dynident_service.wire_types.shared_types import Table

router = APIRouter(prefix="/v1/drive_gains", tags=["drive gains"])


def _build_tables(_: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.adapters.drive_gains import build_gain_tables
        from dynident_service.adapters.field_by_field import show_tables

    return show_tables(build_gain_tables(DriveGainsResult.model_validate(resource.result)))


@add_create_route(
    router,
    ResourceRoutes(
        "drive_gains",
        DriveGainsView,
        parent_kind="robot",
        plural="drive_gains",
        words="drive gains",
        show_description="Show drive gains, with the result once there is one.",
        delete_description="Delete drive gains; the robot keeps those that it states.",
        tables=_build_tables,
    ),
    NewJob("drive_gains", "dynident_service.job_functions.drive_gains:find_gains"),
)
def create_drive_gains(services: Services, body: DriveGainsRequest) -> Sequence[Dependency]:
    """Identify the drive gains from the same motion without and with a load of known mass."""
    robot = require_robot(services, body.robot_id)
    refuse_coupled(robot, "gains are identified only for")
    needs = (depend_on(robot), *_require_measurements(services, body, robot))
    _check_loads(services, body)
    return needs


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
        from dynident.identification.loads.drive_gain_request import KnownLoad
        from dynident.identification.loads.payloads_of_recordings import parse_payload
        from dynident_service.adapters.field_by_field import to_request

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
