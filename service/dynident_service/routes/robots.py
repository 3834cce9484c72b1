"""Routes of robots: create, change hardware, known robots, bundle of one robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Request, Response
from fastapi.responses import StreamingResponse

from dynident.robot.limits_and_drives import check_hardware
from dynident_service.request_limits import mark_long
from dynident_service.routes.meshes import inherit_meshes
from dynident_service.routes.paging_and_retries import RetryKeyDep, create_or_replay
from dynident_service.routes.resource_routes import ResourceRoutes, add_resource_routes
from dynident_service.science_preload import hold_import_lock
from dynident_service.storage.repository_values import NewResource, Resource, list_meshes
from dynident_service.storage.robot_bundle import RobotBundle
from dynident_service.storage_and_engine import ServicesDep
from dynident_service.wire_types.robots import KnownRobot, KnownRobots, RobotChanges, RobotRequest, RobotView
from dynident_service.wire_types.shared_types import LabelsRequest, to_plain_json

router = APIRouter(prefix="/v1/robots", tags=["robots"])
ZIP = "application/zip"
FILE: dict[int | str, dict[str, Any]] = {200: {"content": {ZIP: {}}, "description": "For `dynident import-robot`"}}


@router.post("", status_code=201)
async def create_robot(
    body: RobotRequest, request: Request, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> RobotView:
    """Store a robot; the answer has its joints and its base parameters."""
    arguments = {"request": to_plain_json(body)}
    # In a child process: reading a description takes time, and libraries that read a stranger's file may crash.
    result = await services.interactive.call(
        request, "dynident_service.job_functions.interactive:describe_requested_robot", dict, arguments
    )
    mesh_names = {mesh["name"] for mesh in result.get("meshes", ())}
    objects = await inherit_meshes(request, services, body.meshes_of, mesh_names, to_plain_json(body))
    new = NewResource(
        "robot", to_plain_json(body), name=body.name, result=result, objects=objects, retry=retry.bind_to_body(body)
    )
    return await to_thread.run_sync(lambda: show_robot(create_or_replay(services, new, response)))


def show_robot(resource: Resource) -> RobotView:
    """Show a stored robot."""
    hardware = {part: resource.request.get(part, []) for part in ("has", "has_not")}
    return RobotView.model_validate(
        {**vars(resource), **(resource.result or {}), **hardware, "meshes": list_meshes(resource)}
    )


def revise_hardware(robot: Resource, body: LabelsRequest) -> Mapping[str, object]:
    """Return what is known of a robot's hardware after a change; the later answer replaces an earlier one."""
    assert isinstance(body, RobotChanges)
    if body.has is None and body.has_not is None:
        return {}
    check_hardware(body.has or (), body.has_not or ())
    stored = {part: robot.request.get(part, []) for part in ("has", "has_not")}
    has = body.has if body.has is not None else [name for name in stored["has"] if name not in (body.has_not or ())]
    has_not = body.has_not if body.has_not is not None else [name for name in stored["has_not"] if name not in has]
    return {"has": list(dict.fromkeys(has)), "has_not": list(dict.fromkeys(has_not))}


add_resource_routes(
    router,
    ResourceRoutes(
        "robot",
        RobotView,
        show=show_robot,
        show_description="Show a robot.",
        delete_description="Delete a robot; 409 while other resources need it.",
        label_description="Rename, tag or archive a robot, or state which parts it has.",
        changes=RobotChanges,
        revise=revise_hardware,
    ),
)


@router.get("/{robot_id}/bundle", response_class=StreamingResponse, responses=FILE)
def get_robot_bundle(robot_id: str, request: Request, services: ServicesDep) -> StreamingResponse:
    """Give a robot with its recordings, models, diagnoses and reports as one ZIP, except unfinished computations."""
    # It is sent as fast as the client reads, which may take minutes.
    mark_long(request.scope)
    services.resources.get("robot", robot_id)
    bundle = RobotBundle(services.database, services.objects, robot_id)
    headers = {"Content-Disposition": f'attachment; filename="{robot_id}.zip"'}
    return StreamingResponse(bundle.stream(), media_type=ZIP, headers=headers)


known_router = APIRouter(prefix="/v1/known-robots", tags=["robots"])


@known_router.get("")
def list_known_robots() -> KnownRobots:
    """List the well-known arms, with the descriptions that robots are made from."""
    with hold_import_lock():
        from dynident.robot import library_names, library_source, library_table

    return KnownRobots(
        items=[
            KnownRobot(
                name=name,
                source=library_source(name),
                description={"format": "modified_dh", "content": library_table(name)},
            )
            for name in library_names()
        ]
    )
