"""Routes of robots, known arms, collision meshes, and postures in which the workbench draws a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, File, Request, Response, UploadFile
from fastapi.responses import StreamingResponse

from dynident.robot.description_formats import BASE_JOINTS
from dynident.robot.limits_and_drives import check_hardware
from dynident_service.jobs.confinement import ComputationLimits
from dynident_service.problems import make_unusable
from dynident_service.request_limits import mark_long
from dynident_service.robots.wire_types import (
    GeometryView,
    KnownRobot,
    KnownRobots,
    MeshesView,
    PosesView,
    PosturesRequest,
    RobotChanges,
    RobotRequest,
    RobotView,
)
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import require_resource
from dynident_service.shared.resource_routes import LabelledPagesDep, RetryKeyDep, create_or_replay, update_labels
from dynident_service.shared.upload_forms import FormRoute, receive_files
from dynident_service.shared.wire_types import MOST_ITEMS, Page, to_plain_json
from dynident_service.storage.repository_values import (
    GEOMETRY,
    NewResource,
    OwnedObject,
    Resource,
    find_mesh_files,
    get_mesh_role,
    list_meshes,
)
from dynident_service.storage.robot_bundle import RobotBundle
from dynident_service.storage_and_engine import Services, ServicesDep

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
        request, "dynident_service.robots.jobs:describe_requested_robot", dict, arguments
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
    result = resource.result or {}
    antecedents = {joint["name"]: joint["antecedent"] for joint in result.get("joints", ())}
    with hold_import_lock():
        from dynident.robot.joint import list_limbs

    limbs = list_limbs(antecedents, len(BASE_JOINTS[result.get("base", "fixed")]))
    shown = {**vars(resource), **result, **hardware, "meshes": list_meshes(resource), "limbs": list(map(vars, limbs))}
    return RobotView.model_validate(shown)


def revise_hardware(robot: Resource, body: RobotChanges) -> Mapping[str, object]:
    """Return what is known of a robot's hardware after a change; the later answer replaces an earlier one."""
    if body.has is None and body.has_not is None:
        return {}
    check_hardware(body.has or (), body.has_not or ())
    stored = {part: robot.request.get(part, []) for part in ("has", "has_not")}
    has = body.has if body.has is not None else [name for name in stored["has"] if name not in (body.has_not or ())]
    has_not = body.has_not if body.has_not is not None else [name for name in stored["has_not"] if name not in has]
    return {"has": list(dict.fromkeys(has)), "has_not": list(dict.fromkeys(has_not))}


@router.get("")
def list_robots(pages: LabelledPagesDep) -> Page[RobotView]:
    """List the robots, newest first."""
    return pages.show("robot", show_robot)


@router.get("/{robot_id}")
def get_robot(robot_id: str, services: ServicesDep) -> RobotView:
    """Show a robot."""
    return show_robot(services.resources.get("robot", robot_id))


@router.delete("/{robot_id}", status_code=204)
def delete_robot(robot_id: str, services: ServicesDep) -> None:
    """Delete a robot; 409 while other resources need it."""
    services.resources.delete("robot", robot_id)


@router.patch("/{robot_id}")
def label_robot(robot_id: str, body: RobotChanges, services: ServicesDep) -> RobotView:
    """Rename, tag or archive a robot, or state which parts it has."""
    hardware = revise_hardware(services.resources.get("robot", robot_id), body)
    return show_robot(update_labels(services, "robot", robot_id, body, hardware))


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


meshes_router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=FormRoute)

TAKE_MESHES = "dynident_service.robots.jobs:read_meshes"


@dataclass(frozen=True)
class StoredMeshes:
    """Meshes that were read: what the robot is to own, of which files its geometry is (by name), what was no mesh."""

    entries: list[dict[str, Any]]
    objects: tuple[OwnedObject, ...]
    files: Mapping[str, OwnedObject]
    unused: tuple[str, ...] = ()


@meshes_router.put("/{robot_id}/meshes")
async def put_meshes(
    robot_id: str,
    request: Request,
    services: ServicesDep,
    files: Annotated[
        list[UploadFile],
        File(max_length=MOST_ITEMS, description="STL, OBJ, DAE or PLY, named as the description names them"),
    ],
) -> MeshesView:
    """Upload meshes that a robot's description names; earlier ones stay unless they are sent again.

    A file is identified by its name and by the folders that it is sent with.
    """
    robot = await to_thread.run_sync(services.resources.get, "robot", robot_id)
    with services.create_scratch_folder() as folder:
        sent = await to_thread.run_sync(_receive_meshes, services, files, folder)
        files_sent = tuple(sent.values())
        await to_thread.run_sync(services.resources.check_room, "robot", files_sent, robot_id)
        stored_meshes = await _read_and_store(request, services, robot.request, sent, find_mesh_files(robot), folder)
        unused = stored_meshes.unused
        # Two uploads at once must not lose files of each other: the geometry is made again until it fits what the robot
        # has.
        while True:
            changes = {"meshes": stored_meshes.entries}
            robot = await to_thread.run_sync(
                services.resources.attach, "robot", robot_id, changes, stored_meshes.objects
            )
            if find_mesh_files(robot) == stored_meshes.files:
                return MeshesView.model_validate({"meshes": list_meshes(robot), "unused": unused})
            # Others came meanwhile: the geometry is that of all of them.
            stored_meshes = await _read_and_store(request, services, robot.request, {}, find_mesh_files(robot), folder)


@meshes_router.get("/{robot_id}/geometry", response_model=GeometryView)
def get_geometry(robot_id: str, services: ServicesDep) -> GeometryView | Response:
    """Show where the robot's links are: the frames of its joints, capsules around its collision geometry, and meshes.

    Meshes are included when their files have been uploaded to the robot's `meshes`.
    """
    robot = services.resources.get("robot", robot_id)
    # With meshes it was computed when they came; without, it follows from the description at once.
    if (geometry := robot.objects.get(GEOMETRY)) is not None:
        return Response(services.objects.get(geometry.key), media_type="application/json")
    with hold_import_lock():
        from dynident_service.robots.adapters import describe_geometry, restore_robot

    return describe_geometry(restore_robot(robot.request))


@meshes_router.post("/{robot_id}/poses")
def find_poses(robot_id: str, body: PosturesRequest, services: ServicesDep) -> PosesView:
    """Compute the frames of the robot's geometry at postures of its joints, including closed loops."""
    with hold_import_lock():
        import numpy as np

        from dynident_service.robots.adapters import describe_poses, restore_robot

    robot = restore_robot(services.resources.get("robot", robot_id).request)
    for index, posture in enumerate(body.positions):
        if len(posture) != robot.n:
            raise make_unusable(f"give a position for each of the joints: {robot.n}", f"/positions/{index}")
    return describe_poses(robot, np.array(body.positions))


async def inherit_meshes(
    request: Request,
    services: Services,
    source_id: str | None,
    mesh_names: Set[str],
    robot_request: Mapping[str, object],
) -> tuple[OwnedObject, ...]:
    """Return the meshes that a new robot, whose description names these, has of another one."""
    if source_id is None:
        return ()
    source = await to_thread.run_sync(require_resource, services, "robot", source_id, "/meshes_of")
    inherited_files = {name: file for name, file in find_mesh_files(source).items() if name in mesh_names}
    if not inherited_files:
        return ()
    with services.create_scratch_folder() as folder:
        stored_meshes = await _read_and_store(request, services, robot_request, {}, inherited_files, folder)
    # The role of a mesh is its place in the description, which may be another one in the new robot.
    owned = [
        replace(stored_meshes.files[mesh["name"]], role=get_mesh_role(k))
        for k, mesh in enumerate(stored_meshes.entries)
        if mesh["name"] in inherited_files
    ]
    return (*stored_meshes.objects, *owned)


def _receive_meshes(services: Services, files: Sequence[UploadFile], folder: Path) -> dict[str, Path]:
    received: dict[str, Path] = {}
    for place, file in enumerate(files):
        name = file.filename or f"file {place + 1}"
        if name in received:
            raise make_unusable(f"{name} is sent twice; send it with its folders", "/files", title="Ambiguous mesh")
        # Not under the name that was sent, which might lead out of the folder.
        received[name] = folder / f"sent-{place}"
        receive_files(services, [file], received[name])
    return received


async def _read_and_store(
    request: Request,
    services: Services,
    robot: Mapping[str, Any],
    sent: Mapping[str, Path],
    existing_files: Mapping[str, OwnedObject],
    folder: Path,
) -> StoredMeshes:
    """Have a child read the meshes, then put what came into the object store."""
    geometry = folder / "geometry.json"

    def collect_arguments() -> dict[str, Any]:  # in a thread: files that are kept are compared with their hashes
        return {
            "request": dict(robot),
            "sent": {name: str(file) for name, file in sent.items()},
            "kept": {name: str(services.objects.fetch_file(owned.key)) for name, owned in existing_files.items()},
            "destination": str(geometry),
        }

    sizes = [*(file.stat().st_size for file in sent.values()), *(owned.size for owned in existing_files.values())]
    arguments = await to_thread.run_sync(collect_arguments)
    read_meshes = await services.interactive.call(
        request, TAKE_MESHES, dict, arguments, ComputationLimits.from_file_sizes(*sizes), is_long=True
    )

    def store_objects() -> StoredMeshes:
        files, put = dict(existing_files), services.resources.put_with_role
        new = [put(GEOMETRY, geometry, "application/json")]
        for place, mesh in enumerate(read_meshes["meshes"]):
            if (file := read_meshes["chosen"].get(mesh["name"])) is not None:
                files[mesh["name"]] = put(get_mesh_role(place), sent[file], "application/octet-stream")
                new.append(files[mesh["name"]])
        return StoredMeshes(read_meshes["meshes"], tuple(new), files, tuple(read_meshes["unused"]))

    return await to_thread.run_sync(store_objects)
