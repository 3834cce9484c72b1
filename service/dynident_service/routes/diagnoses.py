"""Routes of diagnoses: create, evidence figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Query

from dynident_service.problems import ProblemError, make_unusable
from dynident_service.routes.paging_and_retries import require_succeeded
from dynident_service.routes.required_resources import depend_on, get_model_joints, require_measurements, require_model
from dynident_service.routes.resource_routes import ResourceRoutes, add_create_route
from dynident_service.science_preload import hold_import_lock
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services, ServicesDep
from dynident_service.wire_types.diagnoses import DiagnosisRequest, DiagnosisView, Evidence
from dynident_service.wire_types.shared_types import Table

router = APIRouter(prefix="/v1/diagnoses", tags=["diagnoses"])


def _build_tables(services: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.adapters.diagnoses import build_stored_tables

    return build_stored_tables(resource.result or {}, get_model_joints(services, resource))


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
    NewJob("diagnosis", "dynident_service.job_functions.diagnoses:diagnose_model"),
)
def create_diagnosis(services: Services, body: DiagnosisRequest) -> Sequence[Dependency]:
    """Find the effects that an identified model lacks, by name, and what to add."""
    with hold_import_lock():
        from dynident.diagnosis import DiagnosisChoices
        from dynident_service.adapters.field_by_field import to_request

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
        from dynident_service.adapters.diagnoses import read_evidence

    diagnosis = require_succeeded(services.resources.get("diagnosis", diagnosis_id))
    if "evidence" not in diagnosis.objects:
        detail = f"The diagnosis {diagnosis_id} was made without figures; diagnose again."
        raise ProblemError(404, detail, title="No figure")
    return read_evidence(services.objects.get(diagnosis.objects["evidence"].key), rank, joint)
