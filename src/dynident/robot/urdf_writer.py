"""Write a robot as URDF."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.robot.joint import Joint
from dynident.robot.pinocchio_conversion import to_dynamic_parameters
from dynident.robot.robot_model import Robot, Tie
from dynident.robot.xml_text import Element, format_numbers, write_xml

_BASE = "base"


def urdf_from_robot(robot: Robot) -> str:
    """Return the URDF text of a robot, with kinematics, limits and inertias to the last digit.

    Parameters
    ----------
    robot : Robot
        The robot; a machine of joints that follow others is written as its tree, with <mimic>.

    Returns
    -------
    str
        The URDF, indented.

    Raises
    ------
    DynidentError
        If a link has inertial parameters but no positive mass (a URDF states the centre of mass, which then does not
        exist), the robot has closed loops, or a joint follows several others.
    """
    parameters = robot.inertias
    ties = {} if robot.linkage is None else robot.linkage.ties
    if robot.linkage is not None and robot.linkage.closure is not None:
        raise DynidentError(
            f"{robot.name} has closed loops, but a URDF can only describe a tree. Export MJCF, C code, a CasADi "
            "function or JSON.",
            title="Not expressible in URDF",
        )
    robot = robot.tree
    links = name_links(robot)
    root = Element("robot", {"name": robot.name}, 0)
    root.children.append(Element("link", {"name": _BASE}, 0))
    for index, joint in enumerate(robot.joints):
        parent = _BASE if joint.parent < 0 else links[joint.parent]
        root.children.append(_build_joint(joint, parent, links[index]))
        if joint.name in ties:
            root.children[-1].children.append(_build_mimic(joint.name, ties[joint.name]))
        link = Element("link", {"name": links[index]}, 0)
        if parameters is not None and np.any(parameters[index]):
            link.children.append(build_inertial(parameters[index], links[index]))
        root.children.append(link)
    return '<?xml version="1.0"?>\n' + write_xml(root, indent=True)


def name_links(robot: Robot) -> list[str]:
    """Return a unique name for the link of every joint: its own where it has one."""
    names: list[str] = []
    for index, joint in enumerate(robot.joints):
        # Links may have equal names in other formats, or that of the base; a URDF needs them unique.
        name = joint.link or f"link{index + 1}"
        while name in (*names, _BASE):
            name += "_"
        names.append(name)
    return names


def _build_joint(joint: Joint, parent: str, child: str) -> Element:
    bounded = joint.limits.position is not None
    # A URDF demands a range of every revolute joint; one without is called continuous.
    kind = "continuous" if joint.kind == "revolute" and not bounded else joint.kind
    element = Element("joint", {"name": joint.name, "type": kind}, 0)
    rotation, translation = joint.placement[:3, :3], joint.placement[:3, 3]
    # Zeros where no limit is known: they are read as such again.
    limit = {
        "velocity": format_numbers(joint.limits.velocity or 0.0),
        "effort": format_numbers(joint.limits.effort or 0.0),
    }
    if joint.limits.position is not None:
        limit |= {"lower": format_numbers(joint.limits.position[0]), "upper": format_numbers(joint.limits.position[1])}
    element.children.extend(
        [
            Element(
                "origin",
                {"xyz": format_numbers(*translation), "rpy": format_numbers(*pin.rpy.matrixToRpy(rotation))},
                0,
            ),
            Element("parent", {"link": parent}, 0),
            Element("child", {"link": child}, 0),
            Element("axis", {"xyz": format_numbers(*joint.axis)}, 0),
            Element("limit", limit, 0),
        ]
    )
    return element


def _build_mimic(joint: str, tie: Tie) -> Element:
    if len(tie.ratios) != 1:
        raise DynidentError(
            f"Joint '{joint}' follows {len(tie.ratios)} joints, but a <mimic> of a URDF can follow only one. Export "
            "MJCF, C code, a CasADi function or JSON.",
            title="Not expressible in URDF",
        )
    [(other, ratio)] = tie.ratios.items()
    return Element(
        "mimic", {"joint": other, "multiplier": format_numbers(ratio), "offset": format_numbers(tie.offset)}, 0
    )


def build_inertial(inertial: FloatArray, link: str) -> Element:
    """Return the `<inertial>` of a link, to the last digit.

    Parameters
    ----------
    inertial : (10,)
        Inertial parameters in the order of `INERTIAL_NAMES`.
    link : str
        Name of the link, for messages.

    Returns
    -------
    Element
        With <origin>, <mass> and <inertia>.

    Raises
    ------
    DynidentError
        If the mass is not positive.
    """
    if inertial[9] <= 0:
        raise DynidentError(
            f"Link '{link}' has the mass {inertial[9]:g} kg, but a URDF needs a positive mass. Export physically "
            "feasible parameters.",
            title="Not expressible in URDF",
        )
    # Inertial parameters are about the frame's origin, a URDF states the inertia about the centre of mass.
    body = pin.Inertia.FromDynamicParameters(to_dynamic_parameters(inertial))
    tensor = {
        f"i{'xyz'[row]}{'xyz'[column]}": format_numbers(body.inertia[row, column])
        for row in range(3)
        for column in range(row, 3)
    }
    element = Element("inertial", {}, 0)
    element.children.extend(
        [
            Element("origin", {"xyz": format_numbers(*body.lever), "rpy": "0 0 0"}, 0),
            Element("mass", {"value": format_numbers(body.mass)}, 0),
            Element("inertia", tensor, 0),
        ]
    )
    return element
