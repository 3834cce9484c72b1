"""The roles in which a robot owns the files of its meshes and the geometry that was read from them."""

from __future__ import annotations

from dynident_service.storage.records import Owned, Resource

GEOMETRY = "geometry"


def role_of(place: int) -> str:
    """The role of a mesh's file; `place` is the mesh's among those that the description names."""
    return f"mesh-{place}"


def meshes_of(robot: Resource) -> dict[str, Owned]:
    """The files of meshes that a robot has, by the meshes' names."""
    named = enumerate((robot.result or {}).get("meshes", []))
    owned = ((one["name"], robot.objects.get(role_of(place))) for place, one in named)
    return {name: found for name, found in owned if found is not None}


def named_meshes(robot: Resource) -> list[dict[str, object]]:
    """All meshes that a robot's description names, with hash and size of the files that it has."""
    files = meshes_of(robot)
    return [
        {**one, "sha256": files[one["name"]].key, "size": files[one["name"]].size} if one["name"] in files else one
        for one in (robot.result or {}).get("meshes", [])
    ]
