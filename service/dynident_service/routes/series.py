"""Series of days: what has changed in a robot, and since when."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter, Response

from dynident_service.models.diagnoses import SeriesRequest, SeriesView
from dynident_service.problems import unusable
from dynident_service.routes.common import succeeded
from dynident_service.routes.kept import Kept, asked_for
from dynident_service.routes.needs import needed_measurements, needed_model, resting_on
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import NewJob, RestsOn

router = APIRouter(prefix="/v1/series", tags=["series"])


@asked_for(
    router,
    Kept(
        "series",
        SeriesView,
        of="identification",
        several="series_of_days",
        one="series_of_days",
        words="series",
        deleted="Delete a series; 409 while others rest on it.",
    ),
    NewJob("series", "dynident_service.work.series:follow_robot"),
)
def create_series_of_days(services: Services, body: SeriesRequest) -> Sequence[RestsOn]:
    """Say what has changed in a robot over many days, from which day on, and give every parameter's course."""
    model = needed_model(services, body.identification_id)
    robot = services.resources.get("robot", model.one("robot"))
    needs = [resting_on(model)]
    if body.continues is None and len(body.days) == 1:
        raise unusable("a series takes two days at least; give more, or the series that this one continues", "/days")
    if body.continues is not None:
        earlier = succeeded(services.resources.get("series", body.continues))
        if earlier.one("identification") != model.id:
            detail = f"{body.continues} is of another model; continue a series of {model.id}, or begin a new one."
            raise unusable(detail, "/continues")
        needs.append(RestsOn(earlier.id, "series", "continues", "/continues"))
    used_ids: set[str] = set()
    for number, day in enumerate(body.days):
        pointer = f"/days/{number}/measurement_ids"
        for index, identifier in enumerate(day.measurement_ids):
            if identifier in used_ids:
                raise unusable(f"{identifier} is there twice; each measurement is of one day.", f"{pointer}/{index}")
            used_ids.add(identifier)
        needs += needed_measurements(services, robot, day.measurement_ids, "measurement", pointer)
    return needs


@router.get("/{series_id}/figure", response_class=Response, responses={200: {"content": {"image/svg+xml": {}}}})
def get_courses_figure(series_id: str, services: ServicesDep) -> Response:
    """Draw every parameter's course, with its intervals."""
    resource = succeeded(services.resources.get("series", series_id))
    return Response(services.objects.get(resource.objects["figure"].key), media_type="image/svg+xml")
