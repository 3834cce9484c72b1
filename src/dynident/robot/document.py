"""A robot as JSON values, and back: what a stored model carries with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from dynident.robot.description import robot_from_description
from dynident.robot.model import Description, Robot
from dynident.robot.stated import Drive, Limits


def robot_document(robot: Robot) -> dict[str, Any]:
    """JSON values from which `robot_from_document` makes the same robot."""
    return {
        "name": robot.name,
        "description": asdict(robot.description),
        "limits": {joint.name: asdict(joint.limits) for joint in robot.tree.joints},
        "drives": {
            joint.name: asdict(drive)
            for joint, drive in zip(robot.joints, robot.drives, strict=True)
            if drive != Drive()
        },
        "locked_joints": dict(robot.locked_joints),
        "gravity": [float(value) for value in robot.gravity],
    }


def robot_from_document(document: Mapping[str, Any]) -> Robot:
    """The robot of a document that `robot_document` made."""
    return robot_from_description(
        document["name"],
        Description(**document["description"]),
        limits={
            name: Limits(**{**fields, "position": tuple(fields["position"]) if fields["position"] else None})
            for name, fields in document["limits"].items()
        },
        drives={name: Drive(**fields) for name, fields in document["drives"].items()},
        locked_joints=document["locked_joints"],
        gravity=document["gravity"],
    )
