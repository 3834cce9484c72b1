"""Routes of diagnoses, and of series: one robot monitored over many days."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from dynident_service.diagnoses.wire_types import (
    DetectionLimitOfJoint,
    DiagnosisRequest,
    DiagnosisResult,
    DiagnosisView,
    Evidence,
    NextExperimentRequest,
    NextExperimentView,
    Reason,
    SeriesRequest,
    SeriesView,
)
from dynident_service.problems import ProblemError, make_unusable
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import (
    add_next_experiment,
    depend_on,
    find_newest,
    get_joints_and_units,
    require_measurements,
    require_model,
)
from dynident_service.shared.resource_routes import (
    PagesDep,
    SubmissionDep,
    require_succeeded,
    resource_path,
    show_with_tables,
)
from dynident_service.shared.wire_types import Page, Table
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services, ServicesDep

router = APIRouter(prefix="/v1/diagnoses", tags=["diagnoses"])
DIAGNOSIS = NewJob("diagnosis", "dynident_service.diagnoses.jobs:diagnose_model")
NEXT_EXPERIMENT = NewJob("next_experiment", "dynident_service.diagnoses.jobs:find_next_experiment")
SERIES = NewJob("series", "dynident_service.diagnoses.jobs:follow_robot")


def _build_tables(services: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.diagnoses.adapters import build_stored_tables

    return build_stored_tables(resource.result or {}, *get_joints_and_units(services, resource))


@router.post("", status_code=202)
def create_diagnosis(body: DiagnosisRequest, services: ServicesDep, submit: SubmissionDep) -> DiagnosisView:
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
    needs = (
        depend_on(model),
        *require_measurements(services, robot, body.measurement_ids or [], "measurement", "/measurement_ids"),
        *require_measurements(services, robot, body.baseline_ids, "baseline", "/baseline_ids"),
    )
    return submit(DiagnosisView, "diagnosis", body, DIAGNOSIS, needs)


@router.get("")
def list_diagnoses(pages: PagesDep, identification_id: str | None = None) -> Page[DiagnosisView]:
    """List the diagnoses, newest first; those of one identification if requested."""
    return pages.show("diagnosis", DiagnosisView.show, identification_id)


@router.get("/{diagnosis_id}")
def get_diagnosis(diagnosis_id: str, services: ServicesDep) -> DiagnosisView:
    """Show a diagnosis, with its result once there is one."""
    diagnosis = add_next_experiment(services.resources, services.resources.get("diagnosis", diagnosis_id))
    return DiagnosisView.show(diagnosis, tables=[] if diagnosis.result is None else _build_tables(services, diagnosis))


@router.delete("/{diagnosis_id}", status_code=204)
def delete_diagnosis(diagnosis_id: str, services: ServicesDep) -> None:
    """Delete a diagnosis; 409 while other resources need it."""
    # The searches for a next experiment belong to it.
    services.resources.delete("diagnosis", diagnosis_id, with_kind="next_experiment")


@router.post("/{diagnosis_id}/next_experiment", status_code=202)
def search_next_experiment(
    diagnosis_id: str, services: ServicesDep, submit: SubmissionDep, response: Response
) -> NextExperimentView:
    """Look for a motion that decides what a diagnosis leaves open; a search that was begun before is given again."""
    diagnosis = require_succeeded(services.resources.get("diagnosis", diagnosis_id))
    search = find_newest(services.resources, "next_experiment", diagnosis_id)
    if search is not None:
        response.headers["Location"] = resource_path(search.kind, search.id)
        return NextExperimentView.show(search)
    body = NextExperimentRequest(diagnosis_id=diagnosis_id)
    return submit(NextExperimentView, "next_experiment", body, NEXT_EXPERIMENT, (depend_on(diagnosis),))


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


@router.get("/{diagnosis_id}/why")
def get_reason(
    diagnosis_id: str,
    services: ServicesDep,
    effect: Annotated[str, Query(max_length=100, description="Id of the effect")],
    joint: Annotated[
        str, Query(max_length=200, description="Name of the joint; by default, the one that the effect explains most")
    ] = "",
) -> Reason:
    """Say why an effect is, or is not, among those that are recommended."""
    with hold_import_lock():
        from dynident_service.diagnoses.adapters import restore_diagnosis
        from dynident_service.shared.field_by_field import to_view

    diagnosis = require_succeeded(services.resources.get("diagnosis", diagnosis_id))
    return to_view(Reason, restore_diagnosis(diagnosis.result or {}).why_not(effect, joint))


@router.get("/{diagnosis_id}/limits")
def get_detection_limits(diagnosis_id: str, services: ServicesDep) -> list[DetectionLimitOfJoint]:
    """List the smallest size of each effect on each joint that the recordings would have shown in 95 of 100 cases."""
    with hold_import_lock():
        from dynident_service.shared.field_by_field import to_view

    diagnosis = require_succeeded(services.resources.get("diagnosis", diagnosis_id))
    limits = DiagnosisResult.model_validate(diagnosis.result).detection_limits
    return [to_view(DetectionLimitOfJoint, limit, joint=limit.joints[0] if limit.joints else None) for limit in limits]


experiment_router = APIRouter(prefix="/v1/next_experiments", tags=["diagnoses"])


@experiment_router.get("")
def list_next_experiments(pages: PagesDep, diagnosis_id: str | None = None) -> Page[NextExperimentView]:
    """List the searches for next experiments, newest first; those of one diagnosis if requested."""
    return pages.show("next_experiment", NextExperimentView.show, diagnosis_id)


@experiment_router.get("/{search_id}")
def get_next_experiment(search_id: str, services: ServicesDep) -> NextExperimentView:
    """Show the search for a next experiment, with the experiment once it is found."""
    return NextExperimentView.show(services.resources.get("next_experiment", search_id))


@experiment_router.delete("/{search_id}", status_code=204)
def delete_next_experiment(search_id: str, services: ServicesDep) -> None:
    """Delete the search for a next experiment."""
    services.resources.delete("next_experiment", search_id)


series_router = APIRouter(prefix="/v1/series", tags=["series"])


def _build_series_tables(services: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.diagnoses.adapters import build_stored_series_tables

    return build_stored_series_tables(resource.result or {}, get_joints_and_units(services, resource)[0])


@series_router.post("", status_code=202)
def create_series_of_days(body: SeriesRequest, services: ServicesDep, submit: SubmissionDep) -> SeriesView:
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
    return submit(SeriesView, "series", body, SERIES, needs)


@series_router.get("")
def list_series_of_days(pages: PagesDep, identification_id: str | None = None) -> Page[SeriesView]:
    """List the series, newest first; those of one identification if requested."""
    return pages.show("series", SeriesView.show, identification_id)


@series_router.get("/{series_id}")
def get_series_of_days(series_id: str, services: ServicesDep) -> SeriesView:
    """Show a series, with its result once there is one."""
    return show_with_tables(SeriesView, services, "series", series_id, _build_series_tables)


@series_router.delete("/{series_id}", status_code=204)
def delete_series_of_days(series_id: str, services: ServicesDep) -> None:
    """Delete a series; 409 while other resources need it."""
    services.resources.delete("series", series_id)


@series_router.get("/{series_id}/figure", response_class=Response, responses={200: {"content": {"image/svg+xml": {}}}})
def get_courses_figure(series_id: str, services: ServicesDep) -> Response:
    """Plot every parameter over the days, with its intervals."""
    resource = require_succeeded(services.resources.get("series", series_id))
    return Response(services.objects.get(resource.objects["figure"].key), media_type="image/svg+xml")
