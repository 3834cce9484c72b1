"""What child processes compute of robots, while a request waits: descriptions, meshes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from dynident.robot.collision_reader import list_collision_meshes
from dynident_service.robots.adapters import (
    assign_mesh_files,
    build_robot,
    describe_geometry_with_meshes,
    describe_robot,
    find_base_parameters,
    restore_robot,
)
from dynident_service.robots.wire_types import MeshView, RobotRequest
from dynident_service.shared.wire_types import to_plain_json


def describe_requested_robot(request: Mapping[str, object]) -> dict[str, object]:
    """Return the description of a robot: its joints and its base parameters."""
    body = RobotRequest.model_validate(request)
    robot = build_robot(body)
    return to_plain_json(describe_robot(robot, find_base_parameters(robot, body.base_parameters_tolerance)))


def read_meshes(
    request: Mapping[str, object], sent: Mapping[str, str], kept: Mapping[str, str], destination: str
) -> dict[str, object]:
    """Read mesh files of a robot and write its geometry.

    `sent` has the paths of uploads by the names under which they were sent, `kept` those of files that the robot has,
    by mesh. Return all meshes of the description (`meshes`), the upload of each (`chosen`), and the uploads that belong
    to none (`unused`).
    """
    robot = restore_robot(request)
    file_names = assign_mesh_files(robot, {name: Path(path) for name, path in sent.items()}) if sent else {}
    # What was sent now replaces what the robot had.
    files = {**kept, **{name: sent[file] for name, file in file_names.items()}}
    geometry = describe_geometry_with_meshes(robot, {name: Path(path) for name, path in files.items()})
    Path(destination).write_text(geometry.model_dump_json(), encoding="utf-8")
    meshes = [
        to_plain_json(MeshView(name=name, links=list(links))) for name, links in list_collision_meshes(robot).items()
    ]
    return {"meshes": meshes, "chosen": file_names, "unused": sorted(set(sent) - set(file_names.values()))}
