"""Validations: is an identified model to be trusted."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from dynident_service.models.common import Page, plain
from dynident_service.models.identifications import StoredIdentification
from dynident_service.models.validations import AVAILABLE, ValidationRequest, ValidationView
from dynident_service.problems import ProblemError, unusable
from dynident_service.routes.common import ListQueryDep, RetryKeyDep, computed, make, page_of
from dynident_service.routes.needs import needed_measurements, needed_model
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import NewJob, NewResource, Resource, RestsOn

router = APIRouter(prefix="/v1/validations", tags=["validations"])

JOB = NewJob("validation", "dynident_service.work.validations:validate_model")


@router.post("", status_code=202)
def create_validation(
    body: ValidationRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> ValidationView:
    """Try an identified model: on its own data, on data it has not seen, or for physical sense."""
    if body.kind not in AVAILABLE:
        detail = f"The validation {body.kind!r} is not available in this version; choose from: {', '.join(AVAILABLE)}."
        raise ProblemError(501, detail, title="Validation not available", available=list(AVAILABLE))
    model = needed_model(services, body.identification_id)
    needs = (
        RestsOn(model.id, "identification", "identification", "/identification_id"),
        *_measurements(services, body, model),
    )
    new = NewResource("validation", plain(body), name=body.name, rests_on=needs, job=JOB, retry=retry.of(body))
    return show(make(services, new, response))


@router.get("")
def list_validations(
    services: ServicesDep, query: ListQueryDep, identification_id: Annotated[str | None, Query()] = None
) -> Page[ValidationView]:
    """List the validations, newest first; those of one identification if asked."""
    return page_of(services, "validation", query, show, identification_id)


@router.get("/{validation_id}")
def get_validation(validation_id: str, services: ServicesDep) -> ValidationView:
    """Show a validation, with its result once there is one."""
    return show(services.resources.get("validation", validation_id))


@router.delete("/{validation_id}", status_code=204)
def delete_validation(validation_id: str, services: ServicesDep) -> None:
    """Delete a validation."""
    services.resources.delete("validation", validation_id)


def show(resource: Resource) -> ValidationView:
    """Show a stored validation."""
    return computed(ValidationView, resource)


def _measurements(services: Services, body: ValidationRequest, model: Resource) -> tuple[RestsOn, ...]:
    asked = StoredIdentification.model_validate(model.request)
    if body.kind == "inertia_matrix" or (body.kind == "direct" and body.measurement_ids is not None):
        if body.measurement_ids is None:
            return ()
        raise unusable(f"{body.kind} takes no measurements; leave measurement_ids out", "/measurement_ids")
    if body.kind == "direct":
        chosen = asked.measurement_ids
    else:
        chosen = body.measurement_ids or asked.validation_ids
        if not chosen:
            raise unusable("the model has no validation data; give measurement_ids", "/measurement_ids")
        for index, identifier in enumerate(chosen):
            if identifier in asked.measurement_ids:
                detail = f"the model was identified from {identifier!r}; give data that it has not seen"
                raise unusable(detail, f"/measurement_ids/{index}")
    robot = services.resources.get("robot", model.one("robot"))
    return needed_measurements(services, robot, chosen, "measurement", "/measurement_ids")
