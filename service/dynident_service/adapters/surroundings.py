"""Surroundings between the contract and the science."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from dynident.excitation import Box, Surroundings, ToolRange, Wall
from dynident_service.models import surroundings as wire


def surroundings_of(asked: wire.Surroundings) -> Surroundings:
    """Take surroundings off the wire."""
    tool = asked.tool_range
    return Surroundings(
        self_collision=asked.self_collision,
        floor=asked.floor,
        walls=tuple(Wall(one.name, one.point, one.normal) for one in asked.walls),
        boxes=tuple(Box(one.name, one.center, one.size, one.rpy) for one in asked.boxes),
        tool_range=None if tool is None else ToolRange(tool.low, tool.high, tool.point, tool.joint),
        clearance=asked.clearance,
        link_radius=asked.link_radius,
        may_touch=tuple(asked.may_touch),
    )


def surroundings_document(stated: Surroundings) -> dict[str, Any]:
    """Surroundings as they are asked for; folders of meshes are a matter of one machine."""
    document = asdict(stated)
    del document["mesh_folders"]
    return document
