"""Read robots from URDF by Pinocchio."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import pinocchio as pin

from dynident.robot.linkage import link_joints, lock_followers
from dynident.robot.model import Description, Robot
from dynident.robot.pinocchio_model import DescribedJoints, from_pinocchio
from dynident.robot.rounding import ROUNDING_TOLERANCE
from dynident.robot.settings import settings_from
from dynident.robot.stated import Drive, Limits
from dynident.robot.urdf_xml import TITLE, find_clamped_joints, make_urdf_error, parse_urdf, read_mimics, reduce_urdf
from dynident.robot.xml_text import Element, write_xml


def robot_from_urdf(
    name: str,
    text: str,
    *,
    limits: Mapping[str, Limits] | None = None,
    drives: Mapping[str, Drive] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: Sequence[float] | None = None,
    rounding_tolerance: float = ROUNDING_TOLERANCE,
    pointer: str = "",
) -> Robot:
    """Return the robot that a URDF describes, on a fixed base.

    Revolute, continuous and prismatic joints about any axis move. The links of fixed and locked joints are merged, with
    their inertias, into the link before. Joints of more than one degree of freedom may be locked at their origin, such
    as a floating base that is clamped in a stand. Mimic joints follow others: their links count, but data, drives and
    limits refer to the joints that they follow (`Robot.linkage`). Joints have Pinocchio's order. Inertial parameters
    are about the origin of the joint's frame. Meshes, colours and vendor extensions are ignored.

    Parameters
    ----------
    name, text : str
        Name of the robot; the URDF.
    limits : mapping of joint name to Limits
        They win over the URDF's, field by field. In the URDF, limits of zero or larger than those of any machine count
        as not stated.
    drives, locked_joints, gravity
        Drive chains by joint; positions (rad, m) to lock joints at; gravity (m/s², base frame), else (0, 0, -9.81).
    rounding_tolerance : float
        Constants this near to 0, ±1/2, ±1 are mended, see `dynident.robot.rounding`.
    pointer : str
        Where the text is in the user's request.

    Returns
    -------
    Robot

    Raises
    ------
    DynidentError
        If the XML is malformed (line and column), the machine is not a tree of such joints on a fixed base (line,
        joint), or a setting does not fit.
    """
    settings = settings_from(limits, drives, locked_joints, gravity)
    root = parse_urdf(text, pointer)
    locked_by_user = settings.locked_joints
    clamped = find_clamped_joints(root, locked_by_user, pointer)
    tree, ties = reduce_urdf(root, pointer, clamped), read_mimics(root, pointer)
    locked = {name: position for name, position in locked_by_user.items() if name not in clamped}
    settings = replace(settings, locked_joints=lock_followers(ties, locked))
    try:
        model = pin.buildModelFromXML(write_xml(tree))
    except (ValueError, RuntimeError) as error:
        raise make_urdf_error(f"Pinocchio cannot read the URDF: {error}", None, pointer) from error
    joints = {element.attributes["name"]: element for element in tree.iter_children("joint")}
    robot = from_pinocchio(
        model,
        name,
        Description("urdf", text),
        settings,
        DescribedJoints(
            limits={joint: _read_limits(element) for joint, element in joints.items()},
            links={joint: _get_child_link(element) for joint, element in joints.items()},
            fixed=tuple(joint for joint, element in joints.items() if element.attributes["type"] == "fixed"),
        ),
        tolerance=rounding_tolerance,
        pointer=pointer,
    )
    return link_joints(
        replace(robot, locked_joints=dict(locked_by_user)), ties, title=TITLE, locked=settings.locked_joints
    )


def _read_limits(joint: Element) -> Limits:
    limit = joint.find_child("limit")
    if limit is None:
        return Limits()
    lower, upper, velocity, effort = (float(limit.attributes[key]) for key in ("lower", "upper", "velocity", "effort"))
    # Zeros stand for limits that the text does not state, see `urdf_xml`.
    bounded = joint.attributes["type"] != "continuous" and lower < upper
    return Limits(
        position=(lower, upper) if bounded else None,
        velocity=velocity if velocity > 0 else None,
        effort=effort if effort > 0 else None,
    )


def _get_child_link(joint: Element) -> str:
    child = joint.find_child("child")
    return "" if child is None else child.attributes["link"]
