"""Robots, and all that belongs to one in one file, for another service."""

from __future__ import annotations

from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Request, Response
from fastapi.responses import StreamingResponse

from dynident_service.limits import take_long
from dynident_service.models.common import plain
from dynident_service.models.robots import RobotRequest, RobotView
from dynident_service.routes.common import RetryKeyDep, make
from dynident_service.routes.kept import Kept, keep
from dynident_service.routes.meshes import inherited
from dynident_service.services import ServicesDep
from dynident_service.storage.bundle import Bundle
from dynident_service.storage.meshes import named_meshes
from dynident_service.storage.records import NewResource, Resource

router = APIRouter(prefix="/v1/robots", tags=["robots"])
ZIP = "application/zip"
FILE: dict[int | str, dict[str, Any]] = {200: {"content": {ZIP: {}}, "description": "For `dynident import-robot`"}}


@router.post("", status_code=201)
async def create_robot(
    body: RobotRequest, request: Request, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> RobotView:
    """Store a robot; the answer has its joints and its base parameters."""
    arguments = {"request": plain(body)}
    result = await services.awaited.call(request, "dynident_service.work.awaited:describe", dict, arguments)
    mesh_names = {mesh["name"] for mesh in result.get("meshes", ())}
    objects = await inherited(request, services, body.meshes_of, mesh_names, plain(body))
    new = NewResource("robot", plain(body), name=body.name, result=result, objects=objects, retry=retry.of(body))
    return await to_thread.run_sync(lambda: show(make(services, new, response)))


def show(resource: Resource) -> RobotView:
    """Show a stored robot."""
    return RobotView.model_validate({**vars(resource), **(resource.result or {}), "meshes": named_meshes(resource)})


keep(
    router,
    Kept(
        "robot",
        RobotView,
        show=show,
        shown="Show a robot.",
        deleted="Delete a robot; 409 while others rest on it.",
        labelled="Rename, tag or archive a robot.",
    ),
)


@router.get("/{robot_id}/bundle", response_class=StreamingResponse, responses=FILE)
def get_robot_bundle(robot_id: str, request: Request, services: ServicesDep) -> StreamingResponse:
    """Give a robot with its recordings, models, diagnoses and reports as one ZIP, but for what is still computed."""
    take_long(request.scope)
    services.resources.get("robot", robot_id)
    bundle = Bundle(services.database, services.objects, robot_id)
    headers = {"Content-Disposition": f'attachment; filename="{robot_id}.zip"'}
    return StreamingResponse(bundle.stream(), media_type=ZIP, headers=headers)
