"""Robots."""

from __future__ import annotations

from anyio import to_thread
from fastapi import APIRouter, Request, Response

from dynident_service.models.common import Page, plain
from dynident_service.models.robots import RobotRequest, RobotView
from dynident_service.routes.common import LabelledQueryDep, RetryKeyDep, make, page_of
from dynident_service.routes.meshes import inherited
from dynident_service.services import ServicesDep
from dynident_service.storage.meshes import named_meshes
from dynident_service.storage.records import NewResource, Resource

router = APIRouter(prefix="/v1/robots", tags=["robots"])


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


@router.get("")
def list_robots(services: ServicesDep, query: LabelledQueryDep) -> Page[RobotView]:
    """List the robots, newest first."""
    return page_of(services, "robot", query, show)


@router.get("/{robot_id}")
def get_robot(robot_id: str, services: ServicesDep) -> RobotView:
    """Show a robot."""
    return show(services.resources.get("robot", robot_id))


@router.delete("/{robot_id}", status_code=204)
def delete_robot(robot_id: str, services: ServicesDep) -> None:
    """Delete a robot; 409 while others rest on it."""
    services.resources.delete("robot", robot_id)


def show(resource: Resource) -> RobotView:
    """Show a stored robot."""
    return RobotView.model_validate(
        {
            **(resource.result or {}),
            "meshes": named_meshes(resource),
            "id": resource.id,
            "name": resource.name,
            "created_at": resource.created_at,
            "request": resource.request,
            "tags": resource.tags,
            "archived": resource.archived,
        }
    )
