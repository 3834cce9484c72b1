"""Routes of identifications: create, extend, remove effects, ladder, tables, export."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response

from dynident.export.export_request import ExportFormat
from dynident_service.identifications.judgement_routes import FUNCTIONS, find_model_file, refuse_stopped
from dynident_service.identifications.wire_types import (
    ExportQuery,
    ExportsView,
    ExtensionRequest,
    IdentificationRequest,
    IdentificationResult,
    IdentificationView,
    Lineage,
    RemovalRequest,
    StoredIdentification,
)
from dynident_service.problems import make_unusable
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import (
    HasResources,
    PrefetchedResources,
    require_measurements,
    require_resource,
    require_robot,
)
from dynident_service.shared.resource_routes import (
    LabelledPagesDep,
    RetryKeyDep,
    create_or_replay,
    require_succeeded,
    update_labels,
)
from dynident_service.shared.wire_types import LabelsRequest, Page, Tables, to_plain_json
from dynident_service.storage.repository_values import Dependency, NewJob, NewResource, Resource, Retry
from dynident_service.storage_and_engine import Services, ServicesDep

if TYPE_CHECKING:
    from dynident.robot import Robot
from collections.abc import Iterator, Sequence

from dynident_service.diagnoses.wire_types import DiagnosisResult
from dynident_service.shared.wire_types import EffectChoice

_LATEST = 5


def complete_from_diagnoses(services: Services, model: Resource, effects: Sequence[EffectChoice]) -> list[EffectChoice]:
    """Complete choices by shape constants and runs that a diagnosis of the model recommended, where none are given.

    The latest diagnoses count first, those of the model before those of the models that it came from. What was
    recommended more than once (two lines of ripple on a joint) is given out in that order.
    """
    recommended: list[EffectChoice] = [
        choice for diagnosis in _list_diagnoses(services, model) for choice in diagnosis.recommended
    ]
    completed = []
    for requested in effects:
        match = None if requested.shape_parameters or requested.runs else _find_recommended(requested, recommended)
        if match is not None:
            # Each recommendation is given once: the next line of ripple on the same joint gets the next one.
            recommended.remove(match)
        completed.append(match or requested)
    return completed


def _find_recommended(requested: EffectChoice, recommended: Sequence[EffectChoice]) -> EffectChoice | None:
    for choice in recommended:
        if choice.effect == requested.effect and set(choice.joints) == set(requested.joints):
            return choice
    return None


def _list_diagnoses(services: Services, model: Resource) -> Iterator[DiagnosisResult]:
    """Yield the results of the latest diagnoses of a model and of its ancestors."""
    ancestor: Resource | None = model
    while ancestor is not None:
        for diagnosis in services.resources.list_page("diagnosis", _LATEST, on_id=ancestor.id).items:
            if diagnosis.result is not None:
                yield DiagnosisResult.model_validate(diagnosis.result)
        parents = ancestor.get_dependencies("parent")
        ancestor = services.resources.get("identification", parents[0]) if parents else None


router = APIRouter(prefix="/v1/identifications", tags=["identifications"])

EXPORTED: dict[str, Any] = {
    "description": "A file to be saved",
    "content": {
        media_type: {} for media_type in ("application/json", "application/xml", "text/x-c", "application/octet-stream")
    },
    "headers": {
        "Dynident-Notes": {
            "description": (
                "What the format cannot represent, as a JSON list of sentences; only present if there is something."
            ),
            "schema": {"type": "string"},
        },
        "X-Held-Out-Error": {
            "description": "Relative error of the torque on held-out data, where joints move, of a program that reads "
            "all of the file; only present if there are such data, and the file is a model of the torque.",
            "schema": {"type": "number"},
        },
    },
}
JOB = NewJob("identification", "dynident_service.identifications.jobs:identify_model")
EXTENSION = NewJob("extension", "dynident_service.identifications.jobs:extend_model")
REMOVAL = NewJob("removal", "dynident_service.identifications.jobs:remove_from_model")


@router.post("", status_code=202)
def create_identification(
    body: IdentificationRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> IdentificationView:
    """Identify the base parameters of a robot from measurements."""
    with hold_import_lock():
        from dynident_service.robots.adapters import restore_cached_robot

    # All resources that the request names are read by one query.
    ahead = PrefetchedResources(services.resources, list_named_ids(body))
    new = new_identification(ahead, body, lambda robot: restore_cached_robot(robot.request))
    return show_identification(create_or_replay(services, replace(new, retry=retry.bind_to_body(body)), response))


@router.get("")
def list_identifications(
    pages: LabelledPagesDep,
    robot_id: Annotated[str | None, Query()] = None,
    brief: Annotated[
        bool, Query(description="Without the parameters, which are most of a list: their lists are empty")
    ] = False,
) -> Page[IdentificationView]:
    """List the identifications, newest first; those of one robot if requested."""
    return pages.show("identification", _show_briefly if brief else show_identification, robot_id)


@router.get("/{identification_id}/tables")
def get_tables(
    identification_id: str,
    services: ServicesDep,
    diagnosis_id: Annotated[str | None, Query(description="Diagnosis that knows the noise floor")] = None,
) -> Tables:
    """Show errors, parameters and shape constants as tables for people, as on the command line and in reports."""
    with hold_import_lock():
        from dynident_service.identifications.adapters import build_identification_tables
        from dynident_service.shared.field_by_field import show_tables

    identification = require_succeeded(services.resources.get("identification", identification_id))
    result = IdentificationResult.model_validate(identification.result)
    diagnosis = None if diagnosis_id is None else require_resource(services, "diagnosis", diagnosis_id, "diagnosis_id")
    floor = (
        None if diagnosis is None else DiagnosisResult.model_validate(require_succeeded(diagnosis).result).noise_floor
    )
    return Tables(items=show_tables(build_identification_tables(result, floor)))


@router.post("/{identification_id}/extend", status_code=202)
def extend_identification(
    identification_id: str, body: ExtensionRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> IdentificationView:
    """Add effects to an identified model: makes a new identification, whose parent is this one."""
    with hold_import_lock():
        from dynident.identification.shape_search import check_choices
        from dynident_service.robots.adapters import restore_robot
        from dynident_service.shared.field_by_field import from_wire_choices

    parent = require_succeeded(services.resources.get("identification", identification_id))
    stored_request = StoredIdentification.model_validate(parent.request)
    robot = require_robot(services, parent.get_dependency("robot"))
    added = complete_from_diagnoses(services, parent, body.effects)
    check_choices(from_wire_choices(added), restore_robot(robot.request))
    # The request of the new model is the whole model, so that it can be made again without its parents.
    changes = {"effects": [*stored_request.effects, *added], "added": added, "removed": []}
    new = _build_next_step(
        parent,
        stored_request,
        {**changes, "name": body.name or stored_request.name},
        EXTENSION,
        retry.bind_to_body(body),
    )
    return show_identification(create_or_replay(services, new, response))


@router.post("/{identification_id}/remove", status_code=202)
def remove_from_identification(
    identification_id: str, body: RemovalRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> IdentificationView:
    """Remove effects from an identified model: makes a new identification, whose parent is this one."""
    with hold_import_lock():
        from dynident.identification.identified_models.remove_and_solve_again import subtract_effects
        from dynident_service.robots.adapters import restore_robot
        from dynident_service.shared.field_by_field import from_wire_choices, show_choice

    parent = require_succeeded(services.resources.get("identification", identification_id))
    stored_request = StoredIdentification.model_validate(parent.request)
    robot = restore_robot(require_robot(services, parent.get_dependency("robot")).request)
    # Those of the result have the shape constants that were found.
    result = show_identification(parent).result
    effects = stored_request.effects if result is None else result.effects
    remaining = subtract_effects(from_wire_choices(effects), from_wire_choices(body.effects), robot)
    changes = {"effects": [show_choice(choice) for choice in remaining], "added": [], "removed": body.effects}
    new = _build_next_step(
        parent, stored_request, {**changes, "name": body.name or stored_request.name}, REMOVAL, retry.bind_to_body(body)
    )
    return show_identification(create_or_replay(services, new, response))


@router.get("/{identification_id}/lineage")
def get_lineage(
    identification_id: str,
    services: ServicesDep,
    against: Annotated[str | None, Query(description="Another identification, to compare its ladder")] = None,
) -> Lineage:
    """Show the ladder of models that led here: what was added or removed, and the errors at each step.

    An extension by several effects has a step for each. If all steps have validation errors, the best one is marked,
    and the later ones whose error is larger.
    """
    with hold_import_lock():
        from dynident_service.identifications.adapters import add_ladder_tables, build_steps_of_views, compare_ladders

    own = _load_ladder(services, identification_id)
    joints = [] if own[-1].result is None else own[-1].result.joints
    if against is None:
        return add_ladder_tables(Lineage(items=build_steps_of_views(own)), joints, own[-1].parent_id)
    other = _load_ladder(services, require_resource(services, "identification", against, "against").id)
    if own[-1].robot_id != other[-1].robot_id:
        detail = f"{against} is a model of another robot; compare ladders of one robot"
        raise make_unusable(detail, "against", title="Another robot")
    # The errors of two ladders can be compared only on the same recordings.
    same_data = len({(*v.request.measurement_ids, "-", *v.request.validation_ids) for v in [*own, *other]}) == 1
    lineage = compare_ladders(build_steps_of_views(own), build_steps_of_views(other), same_data)
    return add_ladder_tables(lineage, joints, own[-1].parent_id)


@router.get("/{identification_id}/export", response_class=Response, responses={200: EXPORTED})
async def export_identification(
    identification_id: str,
    request: Request,
    services: ServicesDep,
    query: Annotated[ExportQuery, Query()],
) -> Response:
    """Give the identified model in a format that other programs read."""
    return await _export(identification_id, request, services, query)


SHORT_NAMES: Mapping[str, ExportFormat] = {"cpp": "cpp_header", "franka": "franka_load", "kuka": "kuka_load"}


@router.get("/{identification_id}/exports/{format}", response_class=Response, responses={200: EXPORTED})
async def get_export(
    identification_id: str,
    format: Literal[ExportFormat, "cpp", "franka", "kuka"],
    request: Request,
    services: ServicesDep,
    nearest: bool = False,
    anyway: bool = False,
) -> Response:
    """Give the identified model in a format; the header X-Held-Out-Error has the error that its reader computes."""
    with hold_import_lock():
        from dynident.export import ExportChoices

    chosen = SHORT_NAMES.get(format, cast(ExportFormat, format))
    return await _export(identification_id, request, services, ExportChoices(chosen, nearest=nearest, anyway=anyway))


@router.get("/{identification_id}/exports")
async def list_exports(identification_id: str, request: Request, services: ServicesDep) -> ExportsView:
    """List the formats, with what each holds, its error on held-out data, and why a model cannot be written so."""
    sent = {"model": await find_model_file(services, identification_id)}
    return ExportsView.model_validate(
        await services.interactive.call(request, f"{FUNCTIONS}:list_exports", dict, sent, is_long=True)
    )


async def _export(identification_id: str, request: Request, services: Services, choices: ExportQuery) -> Response:
    with hold_import_lock():
        from dynident.export import ExportedFile
        from dynident_service.identifications.adapters import build_file_response

    def collect_shown() -> dict[str, Any]:
        identification = require_succeeded(services.resources.get("identification", identification_id))
        if not choices.anyway:
            refuse_stopped(identification)
        return {
            "robot": services.resources.get("robot", identification.get_dependency("robot")).request,
            **to_plain_json(show_identification(identification)),
        }

    sent = {
        "model": await find_model_file(services, identification_id),
        "format": choices.format,
        "nearest": choices.nearest,
        "shown": await to_thread.run_sync(collect_shown),
    }
    return build_file_response(await services.interactive.call(request, f"{FUNCTIONS}:export", ExportedFile, sent))


def list_named_ids(body: IdentificationRequest) -> tuple[str, ...]:
    """Return the ids of all that a request names."""
    return (body.robot_id, *body.measurement_ids, *body.validation_ids)


def new_identification(
    services: HasResources, body: IdentificationRequest, robot_of: Callable[[Resource], Robot]
) -> NewResource:
    """Return what is to be computed."""
    with hold_import_lock():
        from dynident.identification.shape_search import check_choices
        from dynident_service.identifications.adapters import to_choices

    robot = require_robot(services, body.robot_id)
    check_choices(to_choices(body).effects, robot_of(robot))
    needs = (
        Dependency(body.robot_id, "robot", "robot", "/robot_id"),
        *require_measurements(services, robot, body.measurement_ids, "training", "/measurement_ids"),
        *require_measurements(services, robot, body.validation_ids, "validation", "/validation_ids"),
    )
    return NewResource("identification", to_plain_json(body), name=body.name, rests_on=needs, job=JOB)


def _show_briefly(resource: Resource) -> IdentificationView:
    """Show a stored identification without its parameters."""
    # Taken out before they are validated: otherwise they would cost nearly as much as if they were sent.
    result = None if resource.result is None else {**resource.result, "parameters": []}
    return show_identification(replace(resource, result=result))


def show_identification(resource: Resource) -> IdentificationView:
    """Show a stored identification."""
    stored_request = StoredIdentification.model_validate(resource.request)
    parents = resource.get_dependencies("parent")
    return IdentificationView.show(
        resource,
        request=stored_request.model_dump(exclude={"added", "removed"}),
        robot_id=resource.get_dependency("robot"),
        parent_id=parents[0] if parents else None,
        added=stored_request.added,
        removed=stored_request.removed,
    )


@router.get("/{identification_id}")
def get_identification(identification_id: str, services: ServicesDep) -> IdentificationView:
    """Show an identification, with its result once there is one."""
    return show_identification(services.resources.get("identification", identification_id))


@router.delete("/{identification_id}", status_code=204)
def delete_identification(identification_id: str, services: ServicesDep) -> None:
    """Delete an identification; 409 while other resources need it."""
    services.resources.delete("identification", identification_id)


@router.patch("/{identification_id}")
def label_identification(identification_id: str, body: LabelsRequest, services: ServicesDep) -> IdentificationView:
    """Rename, tag or archive an identification."""
    return show_identification(update_labels(services, "identification", identification_id, body))


def _build_next_step(
    parent: Resource, stored_request: StoredIdentification, changes: dict[str, object], job: NewJob, retry: Retry | None
) -> NewResource:
    """Return what is to be computed from a model: its request with some of it changed."""
    # The changes come from models that were validated: a copy does not check them again.
    request = stored_request.model_copy(update=changes)
    return NewResource(
        "identification",
        to_plain_json(request),
        name=request.name,
        rests_on=(
            Dependency(parent.id, "identification", "parent", "/"),
            Dependency(parent.get_dependency("robot"), "robot", "robot", "/"),
            *(Dependency(identifier, "measurement", "training", "/") for identifier in stored_request.measurement_ids),
            *(Dependency(identifier, "measurement", "validation", "/") for identifier in stored_request.validation_ids),
        ),
        job=job,
        retry=retry,
    )


def _load_ladder(services: Services, identifier: str) -> list[IdentificationView]:
    """Return the models that led to one, the first one first."""
    views = []
    next_id: str | None = identifier
    while next_id is not None:
        views.append(show_identification(services.resources.get("identification", next_id)))
        next_id = views[-1].parent_id
    return views[::-1]
