"""Routes of series over days."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter, Response

from dynident_service.problems import make_unusable
from dynident_service.routes.paging_and_retries import require_succeeded
from dynident_service.routes.required_resources import depend_on, get_model_joints, require_measurements, require_model
from dynident_service.routes.resource_routes import ResourceRoutes, add_create_route
from dynident_service.science_preload import hold_import_lock
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services, ServicesDep
from dynident_service.wire_types.diagnoses import SeriesRequest, SeriesView
from dynident_service.wire_types.shared_types import Table

router = APIRouter(prefix="/v1/series", tags=["series"])


def _build_tables(services: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.adapters.diagnoses import build_stored_series_tables

    return build_stored_series_tables(resource.result or {}, get_model_joints(services, resource))


@add_create_route(
    router,
    ResourceRoutes(
        "series",
        SeriesView,
        tables=_build_tables,
        parent_kind="identification",
        plural="series_of_days",
        singular="series_of_days",
        words="series",
        delete_description="Delete a series; 409 while other resources need it.",
    ),
    NewJob("series", "dynident_service.job_functions.series:follow_robot"),
)
def create_series_of_days(services: Services, body: SeriesRequest) -> Sequence[Dependency]:
    """Find what has changed in a robot over many days, since which day, and every parameter over the days."""
    model = require_model(services, body.identification_id)
    robot = services.resources.get("robot", model.get_dependency("robot"))
    needs = [depend_on(model)]
    if body.continues is None and len(body.days) == 1:
        raise make_unusable(
            "a series needs at least two days; give more, or the series that this one continues", "/days"
        )
    if body.continues is not None:
        earlier = require_succeeded(services.resources.get("series", body.continues))
        if earlier.get_dependency("identification") != model.id:
            detail = f"{body.continues} is of another model; continue a series of {model.id}, or begin a new one."
            raise make_unusable(detail, "/continues")
        needs.append(Dependency(earlier.id, "series", "continues", "/continues"))
    # A measurement on two days would make these days look more alike than they are.
    used_ids: set[str] = set()
    for number, day in enumerate(body.days):
        pointer = f"/days/{number}/measurement_ids"
        for index, identifier in enumerate(day.measurement_ids):
            if identifier in used_ids:
                raise make_unusable(
                    f"{identifier} is given twice; each measurement belongs to one day.", f"{pointer}/{index}"
                )
            used_ids.add(identifier)
        needs += require_measurements(services, robot, day.measurement_ids, "measurement", pointer)
    return needs


@router.get("/{series_id}/figure", response_class=Response, responses={200: {"content": {"image/svg+xml": {}}}})
def get_courses_figure(series_id: str, services: ServicesDep) -> Response:
    """Plot every parameter over the days, with its intervals."""
    resource = require_succeeded(services.resources.get("series", series_id))
    return Response(services.objects.get(resource.objects["figure"].key), media_type="image/svg+xml")
