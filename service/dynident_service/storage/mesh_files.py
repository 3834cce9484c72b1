"""Roles under which a robot owns its mesh files, and the geometry that was computed from them."""

from __future__ import annotations

from dynident_service.storage.records import OwnedObject, Resource

GEOMETRY = "geometry"


def get_mesh_role(place: int) -> str:
    """Return the role of a mesh file; `place` is the position of the mesh in the robot's description."""
    return f"mesh-{place}"


def find_mesh_files(robot: Resource) -> dict[str, OwnedObject]:
    """Return the mesh files that a robot has, by mesh name."""
    named = enumerate((robot.result or {}).get("meshes", []))
    owned = ((mesh["name"], robot.objects.get(get_mesh_role(place))) for place, mesh in named)
    return {name: file for name, file in owned if file is not None}


def list_meshes(robot: Resource) -> list[dict[str, object]]:
    """Return all meshes that a robot's description names, with hash and size of the files that the robot has."""
    files = find_mesh_files(robot)
    return [
        {**mesh, "sha256": files[mesh["name"]].key, "size": files[mesh["name"]].size} if mesh["name"] in files else mesh
        for mesh in (robot.result or {}).get("meshes", [])
    ]
