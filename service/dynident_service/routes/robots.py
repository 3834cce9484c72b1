"""Robots, and all that belongs to one in one file, for another service."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Depends, Request, Response
from fastapi.responses import FileResponse

from dynident_service.limits import party_of_request, take_long
from dynident_service.models.common import plain
from dynident_service.models.robots import RobotRequest, RobotView
from dynident_service.problems import ProblemError
from dynident_service.routes.common import RetryKeyDep, make
from dynident_service.routes.kept import Kept, keep
from dynident_service.routes.meshes import inherited
from dynident_service.routes.uploads import require_room_for
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.bundle import export_robot
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
    asked = {"request": plain(body)}
    result = await services.awaited.call(request, "dynident_service.work.awaited:describe", dict, asked)
    named = {one["name"] for one in result.get("meshes", ())}
    objects = await inherited(request, services, body.meshes_of, named, plain(body))
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


async def bundle_folder(request: Request, services: ServicesDep) -> AsyncIterator[Path]:
    """Give a folder for a bundle, until its client has read it; a problem 429 where too many are read."""
    party, places = party_of_request(request.scope), services.bundles
    if not places.may_take(party):
        detail = (
            f"{places.held[party]} bundles are read by you, of {places.total} at a time, of which some stay free for "
            "others; read one after the other."
        )
        raise ProblemError(429, detail, title="Too busy")
    places.take(party)
    try:
        with services.scratch() as folder:
            yield folder
    finally:
        places.give_back(party)


@router.get("/{robot_id}/bundle", response_class=FileResponse, responses=FILE)
async def get_robot_bundle(
    robot_id: str, request: Request, services: ServicesDep, folder: Annotated[Path, Depends(bundle_folder)]
) -> FileResponse:
    """Give a robot with its recordings, models, diagnoses and reports as one ZIP, but for what is still computed."""
    take_long(request.scope)
    path = folder / "bundle.zip"
    await to_thread.run_sync(_write, services, robot_id, path, limiter=CapacityLimiter(1))
    return FileResponse(path, media_type=ZIP, filename=f"{robot_id}.zip")


def _write(services: Services, robot_id: str, path: Path) -> None:
    services.resources.get("robot", robot_id)
    require_room_for(services, 0)
    export_robot(services.database, services.objects, robot_id, path)
