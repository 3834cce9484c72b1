"""Diagnoses: what is missing in a model."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from dynident_service.models.common import Page, plain
from dynident_service.models.diagnoses import DiagnosisRequest, DiagnosisView
from dynident_service.routes.common import ListQueryDep, RetryKeyDep, computed, make, page_of
from dynident_service.routes.needs import needed_measurements, needed_model
from dynident_service.services import ServicesDep
from dynident_service.storage.records import NewJob, NewResource, Resource, RestsOn

router = APIRouter(prefix="/v1/diagnoses", tags=["diagnoses"])

JOB = NewJob("diagnosis", "dynident_service.work.diagnoses:diagnose_model")


@router.post("", status_code=202)
def create_diagnosis(
    body: DiagnosisRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> DiagnosisView:
    """Find what is missing in an identified model, by name, and what to add."""
    from dynident.effects import effect_by_id

    model = needed_model(services, body.identification_id)
    for index, candidate in enumerate(body.candidates or ()):
        effect_by_id(candidate, f"/candidates/{index}")
    robot = services.resources.get("robot", model.one("robot"))
    needs = (
        RestsOn(model.id, "identification", "identification", "/identification_id"),
        *needed_measurements(services, robot, body.measurement_ids or [], "measurement", "/measurement_ids"),
    )
    new = NewResource("diagnosis", plain(body), name=body.name, rests_on=needs, job=JOB, retry=retry.of(body))
    return show(make(services, new, response))


@router.get("")
def list_diagnoses(
    services: ServicesDep, query: ListQueryDep, identification_id: Annotated[str | None, Query()] = None
) -> Page[DiagnosisView]:
    """List the diagnoses, newest first; those of one identification if asked."""
    return page_of(services, "diagnosis", query, show, identification_id)


@router.get("/{diagnosis_id}")
def get_diagnosis(diagnosis_id: str, services: ServicesDep) -> DiagnosisView:
    """Show a diagnosis, with its result once there is one."""
    return show(services.resources.get("diagnosis", diagnosis_id))


@router.delete("/{diagnosis_id}", status_code=204)
def delete_diagnosis(diagnosis_id: str, services: ServicesDep) -> None:
    """Delete a diagnosis; 409 while others rest on it."""
    services.resources.delete("diagnosis", diagnosis_id)


def show(resource: Resource) -> DiagnosisView:
    """Show a stored diagnosis."""
    return computed(DiagnosisView, resource)
