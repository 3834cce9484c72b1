"""Routes of validations."""

from __future__ import annotations

from fastapi import APIRouter

from dynident_service.identifications.wire_types import StoredIdentification
from dynident_service.problems import make_unusable
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import (
    depend_on,
    get_joints_and_units,
    require_measurements,
    require_model,
)
from dynident_service.shared.resource_routes import PagesDep, SubmissionDep, show_with_tables
from dynident_service.shared.wire_types import Page, Table
from dynident_service.storage.repository_values import Dependency, NewJob, Resource
from dynident_service.storage_and_engine import Services, ServicesDep
from dynident_service.validations.wire_types import ValidationRequest, ValidationResult, ValidationView

router = APIRouter(prefix="/v1/validations", tags=["validations"])
JOB = NewJob("validation", "dynident_service.validations.jobs:validate_model")


def _build_tables(services: Services, resource: Resource) -> list[Table]:
    with hold_import_lock():
        from dynident_service.shared.field_by_field import show_tables
        from dynident_service.validations.adapters import list_stored_tables

    joints, _ = get_joints_and_units(services, resource)
    return show_tables(list_stored_tables(ValidationResult.model_validate(resource.result), joints))


@router.post("", status_code=202)
def create_validation(body: ValidationRequest, services: ServicesDep, submit: SubmissionDep) -> ValidationView:
    """Validate an identified model: on its own data, on data it has not seen, or for physical consistency."""
    _check_fields(body)
    model = require_model(services, body.identification_id)
    needs = [depend_on(model), *_require_measurements(services, body, model)]
    return submit(ValidationView, "validation", body, JOB, needs)


@router.get("")
def list_validations(pages: PagesDep, identification_id: str | None = None) -> Page[ValidationView]:
    """List the validations, newest first; those of one identification if requested."""
    return pages.show("validation", ValidationView.show, identification_id)


@router.get("/{validation_id}")
def get_validation(validation_id: str, services: ServicesDep) -> ValidationView:
    """Show a validation, with its result once there is one."""
    return show_with_tables(ValidationView, services, "validation", validation_id, _build_tables)


@router.delete("/{validation_id}", status_code=204)
def delete_validation(validation_id: str, services: ServicesDep) -> None:
    """Delete a validation."""
    services.resources.delete("validation", validation_id)


def _check_fields(body: ValidationRequest) -> None:
    """Refuse what the test that is asked for does not take."""
    with hold_import_lock():
        from dynident_service.validations.adapters import trial_from_request

    trial = trial_from_request(body)
    if body.measurement_ids is not None and not trial.takes_recordings:
        raise make_unusable(f"{body.kind} takes no measurement_ids; leave it out", "/measurement_ids")


def _require_measurements(services: Services, body: ValidationRequest, model: Resource) -> tuple[Dependency, ...]:
    model_request = StoredIdentification.model_validate(model.request)
    robot = services.resources.get("robot", model.get_dependency("robot"))
    chosen_ids = _select_measurements(body, model_request, _select_motions(services, model_request.measurement_ids))
    # These tell how a model does on data that no parameter saw.
    if body.kind in ("cross", "collision", "methods"):
        for index, identifier in enumerate(chosen_ids):
            if identifier in model_request.measurement_ids:
                detail = f"the model was identified from {identifier!r}; give data that it has not seen"
                raise make_unusable(detail, f"/measurement_ids/{index}")
    needs = require_measurements(services, robot, chosen_ids, "measurement", "/measurement_ids")
    # The load is weighed against the runs without it, which are those of the identification.
    if body.kind == "payload":
        _check_loads(services, body, chosen_ids, model_request)
        needs += require_measurements(
            services, robot, _select_motions(services, model_request.measurement_ids), "training", "/"
        )
    if body.kind == "methods":
        needs += require_measurements(services, robot, model_request.measurement_ids, "training", "/identification_id")
    return needs


def _check_loads(
    services: Services, body: ValidationRequest, loaded: list[str], model_request: StoredIdentification
) -> None:
    """Refuse runs with the load that are those without it, or whose load has no stated mass."""
    mass = body.model_dump(include={"mass"})["mass"]
    for index, identifier in enumerate(loaded):
        if identifier in model_request.measurement_ids:
            detail = f"the model was identified from {identifier!r}; give runs with the load"
            raise make_unusable(detail, f"/measurement_ids/{index}")
        payload = services.resources.get("measurement", identifier).request.get("payload") or {}
        if mass is None and "mass" not in payload:
            raise make_unusable(f'{identifier!r} does not state "payload": {{"mass": …}}; give mass, in kg', "/mass")


def _select_motions(services: Services, identifiers: list[str]) -> list[str]:
    """Return the measurements of motions, without the tests of single joints' friction among them."""
    roles = {
        identifier: services.resources.get("measurement", identifier).request.get("role") for identifier in identifiers
    }
    return [identifier for identifier in identifiers if roles[identifier] != "friction"]


def _select_measurements(body: ValidationRequest, model_request: StoredIdentification, motions: list[str]) -> list[str]:
    """Return the measurements that the test is made on; `motions` are of those that the model was identified from."""
    stated_ids = body.measurement_ids
    match body.kind:
        case "direct":
            return motions
        case "inertia_matrix" | "bootstrap":
            return []
        case "cross" | "collision":
            if not (stated_ids or model_request.validation_ids):
                raise make_unusable("the model has no validation data; give measurement_ids", "/measurement_ids")
            return stated_ids or model_request.validation_ids
        case "methods":
            return stated_ids or model_request.validation_ids
        case "payload":
            if not stated_ids:
                raise make_unusable("give the measurements with the load", "/measurement_ids")
            return stated_ids
        case "drift":
            return stated_ids or model_request.validation_ids or motions
        case "simulation":
            return stated_ids or (model_request.validation_ids or motions)[:1]
        case "filters":
            if stated_ids is not None and len(stated_ids) > 1:
                raise make_unusable("filters needs exactly one measurement", "/measurement_ids/1")
            return stated_ids or motions[:1]
    raise make_unusable(f"there is no validation {body.kind!r}", "/kind")
