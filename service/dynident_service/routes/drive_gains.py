"""Drive gains from runs without and with a load of known mass."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter

from dynident.errors import DynidentError
from dynident_service.models.drive_gains import DriveGainsRequest, DriveGainsResult, DriveGainsView
from dynident_service.models.tables import Table
from dynident_service.problems import unusable
from dynident_service.routes.kept import Kept, asked_for
from dynident_service.routes.needs import needed_measurements, needed_robot, refuse_coupled, resting_on
from dynident_service.science import importing
from dynident_service.services import Services
from dynident_service.storage.records import NewJob, Resource, RestsOn

router = APIRouter(prefix="/v1/drive_gains", tags=["drive gains"])


def _tables(_: Services, resource: Resource) -> list[Table]:
    with importing():
        from dynident_service.adapters.drive_gains import gain_tables
        from dynident_service.adapters.tables import show_tables

    return show_tables(gain_tables(DriveGainsResult.model_validate(resource.result)))


@asked_for(
    router,
    Kept(
        "drive_gains",
        DriveGainsView,
        of="robot",
        several="drive_gains",
        words="drive gains",
        shown="Show drive gains, with the result once there is one.",
        deleted="Delete drive gains; the robot keeps those that it states.",
        tables=_tables,
    ),
    NewJob("drive_gains", "dynident_service.work.drive_gains:find_gains"),
)
def create_drive_gains(services: Services, body: DriveGainsRequest) -> Sequence[RestsOn]:
    """Identify the drive gains from the same motion without and with a load of known mass."""
    robot = needed_robot(services, body.robot_id)
    refuse_coupled(robot, "gains are identified for")
    needs = (resting_on(robot), *_measurements(services, body, robot))
    _check_loads(services, body)
    return needs


def _measurements(services: Services, body: DriveGainsRequest, robot: Resource) -> tuple[RestsOn, ...]:
    """The runs, each without or with its load and not both."""
    if body.weigh is None and body.weigh_unloaded is not None:
        raise unusable("nothing is to be weighed: give weigh, or leave weigh_unloaded out", "/weigh_unloaded")
    runs_without = body.unloaded if body.weigh_unloaded is None else body.weigh_unloaded
    for field, loaded, unloaded in (("loaded", body.loaded, body.unloaded), ("weigh", body.weigh or [], runs_without)):
        for index, identifier in enumerate(loaded):
            if identifier in unloaded:
                detail = f"the measurement {identifier!r} is named as a run without the load too"
                raise unusable(detail, f"/{field}/{index}")
    groups = (
        ("unloaded", body.unloaded),
        ("loaded", body.loaded),
        ("weigh", body.weigh or []),
        ("weigh_unloaded", body.weigh_unloaded or []),
    )
    return tuple(
        need for field, ids in groups for need in needed_measurements(services, robot, ids, field, f"/{field}")
    )


def _check_loads(services: Services, body: DriveGainsRequest) -> None:
    """Somebody must say what the load weighs: the request, or each measurement of itself."""
    with importing():
        from dynident.identification.loads.known import KnownLoad
        from dynident.identification.loads.payloads import stated_payload
        from dynident_service.adapters.derived import taken

    load = taken(body, KnownLoad)
    for index, identifier in enumerate(body.loaded):
        measurement = services.resources.get("measurement", identifier)
        payload = load.over(measurement.request.get("payload"))
        if "mass" not in (payload or {}):
            detail = f'{identifier!r} does not state "payload": {{"mass": …}}; give mass, in kg'
            raise unusable(detail, "/mass")
        try:
            stated_payload(measurement.name or identifier, payload)
        except DynidentError as error:
            raise unusable(error.detail, f"/loaded/{index}", title=error.title) from error
