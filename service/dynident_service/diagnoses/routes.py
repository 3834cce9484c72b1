"""Routes of diagnoses, and of series: one robot monitored over many days."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Query, Response

from dynident_service.diagnoses.wire_types import DiagnosisRequest, DiagnosisView, Evidence, SeriesRequest, SeriesView
from dynident_service.problems import ProblemError, make_unusable
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import (
    depend_on,
    get_joints_and_units,
    require_measurements,
    require_model,
)
from dynident_service.shared.resource_routes import ResourceRoutes, add_create_route, require_succeeded
from dynident_service.shared.wire_types import Table
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/diagnoses", tags=["diagnoses"])


def _build_tables(services: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.diagnoses.adapters import build_stored_tables

    return build_stored_tables(resource.result or {}, *get_joints_and_units(services, resource))


@add_create_route(
    router,
    ResourceRoutes(
        "diagnosis",
        DiagnosisView,
        tables=_build_tables,
        parent_kind="identification",
        plural="diagnoses",
        delete_description="Delete a diagnosis; 409 while other resources need it.",
    ),
    NewJob("diagnosis", "dynident_service.diagnoses.jobs:diagnose_model"),
)
def create_diagnosis(services: Services, body: DiagnosisRequest) -> Sequence[Dependency]:
    """Find the effects that an identified model lacks, by name, and what to add."""
    with hold_import_lock():
        from dynident.diagnosis import DiagnosisChoices
        from dynident_service.shared.field_by_field import to_request

    model = require_model(services, body.identification_id)
    to_request(body, DiagnosisChoices)
    robot = services.resources.get("robot", model.get_dependency("robot"))
    # A change between before and after cannot be seen in a recording that is on both sides.
    later = body.measurement_ids or model.request["measurement_ids"]
    for index, identifier in enumerate(body.baseline_ids):
        if identifier in later:
            detail = (
                f"{identifier} is given as an earlier and as a later measurement; give earlier ones here, later "
                "ones as measurement_ids."
            )
            raise make_unusable(detail, f"/baseline_ids/{index}")
    return (
        depend_on(model),
        *require_measurements(services, robot, body.measurement_ids or [], "measurement", "/measurement_ids"),
        *require_measurements(services, robot, body.baseline_ids, "baseline", "/baseline_ids"),
    )


@router.get("/{diagnosis_id}/evidence")
def get_evidence(
    diagnosis_id: str,
    services: ServicesDep,
    rank: Annotated[int, Query(ge=1, description="Rank of the candidate")],
    joint: Annotated[
        str | None, Query(description="Name of the joint; by default, the one that the effect explains most")
    ] = None,
) -> Evidence:
    """Give the figure for a ranked effect: the residual over its variable, with the fitted effect."""
    with hold_import_lock():
        from dynident_service.diagnoses.adapters import read_evidence

    diagnosis = require_succeeded(services.resources.get("diagnosis", diagnosis_id))
    if "evidence" not in diagnosis.objects:
        detail = f"The diagnosis {diagnosis_id} was made without figures; diagnose again."
        raise ProblemError(404, detail, title="No figure")
    return read_evidence(services.objects.get(diagnosis.objects["evidence"].key), rank, joint)


series_router = APIRouter(prefix="/v1/series", tags=["series"])


def _build_series_tables(services: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.diagnoses.adapters import build_stored_series_tables

    return build_stored_series_tables(resource.result or {}, get_joints_and_units(services, resource)[0])


@add_create_route(
    series_router,
    ResourceRoutes(
        "series",
        SeriesView,
        tables=_build_series_tables,
        parent_kind="identification",
        plural="series_of_days",
        singular="series_of_days",
        words="series",
        delete_description="Delete a series; 409 while other resources need it.",
    ),
    NewJob("series", "dynident_service.diagnoses.jobs:follow_robot"),
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


@series_router.get("/{series_id}/figure", response_class=Response, responses={200: {"content": {"image/svg+xml": {}}}})
def get_courses_figure(series_id: str, services: ServicesDep) -> Response:
    """Plot every parameter over the days, with its intervals."""
    resource = require_succeeded(services.resources.get("series", series_id))
    return Response(services.objects.get(resource.objects["figure"].key), media_type="image/svg+xml")
