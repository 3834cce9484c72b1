"""Diagnoses: what is missing in a model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Query

from dynident_service.models.diagnoses import DiagnosisRequest, DiagnosisView, Evidence
from dynident_service.problems import ProblemError, unusable
from dynident_service.routes.common import succeeded
from dynident_service.routes.kept import Kept, asked_for
from dynident_service.routes.needs import needed_measurements, needed_model, resting_on
from dynident_service.science import importing
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import NewJob, RestsOn

router = APIRouter(prefix="/v1/diagnoses", tags=["diagnoses"])


@asked_for(
    router,
    Kept(
        "diagnosis",
        DiagnosisView,
        of="identification",
        several="diagnoses",
        deleted="Delete a diagnosis; 409 while others rest on it.",
    ),
    NewJob("diagnosis", "dynident_service.work.diagnoses:diagnose_model"),
)
def create_diagnosis(services: Services, body: DiagnosisRequest) -> Sequence[RestsOn]:
    """Find what is missing in an identified model, by name, and what to add."""
    with importing():
        from dynident.diagnosis import DiagnosisChoices
        from dynident_service.adapters.derived import taken

    model = needed_model(services, body.identification_id)
    taken(body, DiagnosisChoices)
    robot = services.resources.get("robot", model.one("robot"))
    later = body.measurement_ids or model.request["measurement_ids"]
    for index, identifier in enumerate(body.baseline_ids):
        if identifier in later:
            detail = f"{identifier} is on both sides; give earlier measurements here, later ones as measurement_ids."
            raise unusable(detail, f"/baseline_ids/{index}")
    return (
        resting_on(model),
        *needed_measurements(services, robot, body.measurement_ids or [], "measurement", "/measurement_ids"),
        *needed_measurements(services, robot, body.baseline_ids, "baseline", "/baseline_ids"),
    )


@router.get("/{diagnosis_id}/evidence")
def get_evidence(
    diagnosis_id: str,
    services: ServicesDep,
    rank: Annotated[int, Query(ge=1, description="Of the candidate")],
    joint: Annotated[str | None, Query(description="Name; that on which it explains most where not given")] = None,
) -> Evidence:
    """Give the figure behind a ranked effect: the residual over what it depends on, and the fitted effect with it."""
    with importing():
        from dynident_service.adapters.diagnoses import read_evidence

    diagnosis = succeeded(services.resources.get("diagnosis", diagnosis_id))
    if "evidence" not in diagnosis.objects:
        detail = f"The diagnosis {diagnosis_id} was made without figures; diagnose again."
        raise ProblemError(404, detail, title="No figure")
    return read_evidence(services.objects.get(diagnosis.objects["evidence"].key), rank, joint)
