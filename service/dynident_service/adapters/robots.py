"""Robots: built from requests, and described as views."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache

from dynident.robot import Description, Drive, Joint, Limits, Robot, robot_from_description
from dynident.robot.collision import list_collision_meshes
from dynident_service.adapters.requests import to_body, to_request
from dynident_service.models import robots as wire


def restore_robot(stored: Mapping[str, object]) -> Robot:
    """Build the robot of a stored request."""
    return build_robot(wire.RobotRequest.model_validate(stored))


def restore_cached_robot(stored: Mapping[str, object]) -> Robot:
    """Build the robot of a stored request, or return the cached one of the same request."""
    # Dictionaries are not hashable: the key of the cache is the sorted JSON, and a stored robot never changes.
    return _restore_from_text(json.dumps(stored, sort_keys=True))


@lru_cache(maxsize=32)
def _restore_from_text(text: str) -> Robot:
    return restore_robot(json.loads(text))


def build_robot(request: wire.RobotRequest) -> Robot:
    """Build the robot that a request describes; `DynidentError` where the description is unusable."""
    content = request.description.content
    # A table of Denavit and Hartenberg may come as JSON in the body itself.
    text = content if isinstance(content, str) else json.dumps(content)
    return robot_from_description(
        request.name,
        Description(request.description.format, text),
        limits={name: to_request(value, Limits) for name, value in request.limits.items()},
        drives={name: to_request(value, Drive) for name, value in request.drives.items()},
        locked_joints=request.locked_joints,
        gravity=request.gravity,
    )


def describe_robot(robot: Robot, base: wire.BaseParametersView) -> wire.RobotResult:
    """Build the view of a robot with its base parameters."""
    return wire.RobotResult(
        joints=[_show_joint(robot, index, joint) for index, joint in enumerate(robot.joints)],
        base_parameters=base,
        has_inertias=robot.inertias is not None,
        meshes=[wire.MeshView(name=name, links=list(links)) for name, links in list_collision_meshes(robot).items()],
    )


def find_base_parameters(robot: Robot, tolerance: float | None) -> wire.BaseParametersView:
    """Find the inertial base parameters of a robot; `tolerance` is the share of a column left unexplained."""
    # Imported here: CasADi takes a second to load, and the rest of this module does without.
    from dynident.effects import EffectChoice, Signals, build_columns
    from dynident.regressors.base_parameters import DEFAULT_TOLERANCE, find_base_parameters

    signals = Signals(robot)
    columns = build_columns([EffectChoice("rigid_body")], signals)
    base_set = find_base_parameters(robot, columns, signals, tolerance=tolerance or DEFAULT_TOLERANCE)
    return wire.BaseParametersView(
        count=base_set.count, rank=base_set.rank, names=list(base_set.kept_names), groupings=list(base_set.groupings)
    )


def _show_joint(robot: Robot, index: int, joint: Joint) -> wire.JointView:
    return wire.JointView(
        name=joint.name,
        type=joint.kind,
        limits=to_body(wire.Limits, joint.limits),
        antecedent=robot.joint_names[joint.parent] if joint.parent >= 0 else None,
        link=joint.link,
        drive_gain=robot.drives[index].gain,
        coupling=dict(robot.drives[index].coupling),
    )
