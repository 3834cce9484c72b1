"""The meshes of robots: uploaded, never fetched; for collisions of designs and for pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, File, Request, Response, UploadFile

from dynident_service.jobs.confinement import Limits
from dynident_service.models.common import MOST_ITEMS
from dynident_service.models.geometry import GeometryView, PosesView, PosturesRequest
from dynident_service.models.robots import MeshesView
from dynident_service.problems import unusable
from dynident_service.routes.forms import FormRoute
from dynident_service.routes.needs import needed
from dynident_service.routes.uploads import receive
from dynident_service.science import importing
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.meshes import GEOMETRY, meshes_of, named_meshes, role_of
from dynident_service.storage.records import Owned

router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=FormRoute)

TAKE = "dynident_service.work.awaited:take_meshes"


@dataclass(frozen=True)
class Taken:
    """Meshes that were read: what the robot is to own, of which files its geometry is (by name), what was no mesh."""

    named: list[dict[str, Any]]
    objects: tuple[Owned, ...]
    files: Mapping[str, Owned]
    unused: tuple[str, ...] = ()


@router.put("/{robot_id}/meshes")
async def put_meshes(
    robot_id: str,
    request: Request,
    services: ServicesDep,
    files: Annotated[
        list[UploadFile],
        File(max_length=MOST_ITEMS, description="STL, OBJ, DAE or PLY, named as the description names them"),
    ],
) -> MeshesView:
    """Give a robot the files of meshes that its description names; those that it has stay unless they come anew.

    A file is known by its name and as many of its folders as it is sent with.
    """
    robot = await to_thread.run_sync(services.resources.get, "robot", robot_id)
    with services.scratch() as folder:
        sent = await to_thread.run_sync(_receive, services, files, folder)
        files_sent = tuple(sent.values())
        await to_thread.run_sync(services.resources.check_room, "robot", files_sent, robot_id)
        stored_meshes = await _taken(request, services, robot.request, sent, meshes_of(robot), folder)
        unused = stored_meshes.unused
        while True:
            changes = {"meshes": stored_meshes.named}
            robot = await to_thread.run_sync(
                services.resources.attach, "robot", robot_id, changes, stored_meshes.objects
            )
            if meshes_of(robot) == stored_meshes.files:
                return MeshesView.model_validate({"meshes": named_meshes(robot), "unused": unused})
            # Others came meanwhile: the geometry is that of all of them.
            stored_meshes = await _taken(request, services, robot.request, {}, meshes_of(robot), folder)


@router.get("/{robot_id}/geometry", response_model=GeometryView)
def get_geometry(robot_id: str, services: ServicesDep) -> GeometryView | Response:
    """Show where the robot's links are: the frames of its joints, capsules around its collision geometry, and meshes.

    Meshes are there once their files have been sent to the robot's `meshes`.
    """
    robot = services.resources.get("robot", robot_id)
    if (geometry := robot.objects.get(GEOMETRY)) is not None:
        return Response(services.objects.get(geometry.key), media_type="application/json")
    with importing():
        from dynident_service.adapters.geometry import describe_geometry
        from dynident_service.adapters.robots import robot_of

    return describe_geometry(robot_of(robot.request))


@router.post("/{robot_id}/poses")
def find_poses(robot_id: str, body: PosturesRequest, services: ServicesDep) -> PosesView:
    """Say where the frames of the robot's geometry are at postures of its joints; closed loops are followed."""
    with importing():
        import numpy as np

        from dynident_service.adapters.geometry import describe_poses
        from dynident_service.adapters.robots import robot_of

    robot = robot_of(services.resources.get("robot", robot_id).request)
    for index, posture in enumerate(body.positions):
        if len(posture) != robot.n:
            raise unusable(f"give a position for each of its joints: {robot.n}", f"/positions/{index}")
    return describe_poses(robot, np.array(body.positions))


async def inherited(
    request: Request,
    services: Services,
    source_id: str | None,
    mesh_names: Set[str],
    robot_request: Mapping[str, object],
) -> tuple[Owned, ...]:
    """What a new robot, whose description names these meshes, has of another one's."""
    if source_id is None:
        return ()
    source = await to_thread.run_sync(needed, services, "robot", source_id, "/meshes_of")
    inherited_files = {name: file for name, file in meshes_of(source).items() if name in mesh_names}
    if not inherited_files:
        return ()
    with services.scratch() as folder:
        stored_meshes = await _taken(request, services, robot_request, {}, inherited_files, folder)
    owned = [
        replace(stored_meshes.files[mesh["name"]], role=role_of(k))
        for k, mesh in enumerate(stored_meshes.named)
        if mesh["name"] in inherited_files
    ]
    return (*stored_meshes.objects, *owned)


def _receive(services: Services, files: Sequence[UploadFile], folder: Path) -> dict[str, Path]:
    received: dict[str, Path] = {}
    for place, file in enumerate(files):
        name = file.filename or f"file {place + 1}"
        if name in received:
            raise unusable(f"{name} comes twice; send it with its folders", "/files", title="Ambiguous mesh")
        received[name] = folder / f"sent-{place}"
        receive(services, [file], received[name])
    return received


async def _taken(
    request: Request,
    services: Services,
    robot: Mapping[str, Any],
    sent: Mapping[str, Path],
    existing_files: Mapping[str, Owned],
    folder: Path,
) -> Taken:
    """Have a child read the meshes, then put what came into the object store."""
    geometry = folder / "geometry.json"

    def asked() -> dict[str, Any]:  # in a thread: files that are kept are compared with their hashes
        return {
            "request": dict(robot),
            "sent": {name: str(file) for name, file in sent.items()},
            "kept": {name: str(services.objects.path(owned.key)) for name, owned in existing_files.items()},
            "destination": str(geometry),
        }

    sizes = [*(file.stat().st_size for file in sent.values()), *(owned.size for owned in existing_files.values())]
    arguments = await to_thread.run_sync(asked)
    read_meshes = await services.awaited.call(request, TAKE, dict, arguments, Limits.for_files(*sizes), is_long=True)

    def stored() -> Taken:
        files, put = dict(existing_files), services.resources.put_as
        new = [put(GEOMETRY, geometry, "application/json")]
        for place, mesh in enumerate(read_meshes["meshes"]):
            if (file := read_meshes["chosen"].get(mesh["name"])) is not None:
                files[mesh["name"]] = put(role_of(place), sent[file], "application/octet-stream")
                new.append(files[mesh["name"]])
        return Taken(read_meshes["meshes"], tuple(new), files, tuple(read_meshes["unused"]))

    return await to_thread.run_sync(stored)
