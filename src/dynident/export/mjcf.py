"""Write the identified model as MJCF, the format of MuJoCo.

Friction is MuJoCo's `frictionloss`, a soft constraint. The solver parameters here make it follow sign(q̇) wherever the
speed is above a thousandth of a second times the acceleration.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dynident.arrays import FloatArray
from dynident.effects import Role, role_of
from dynident.encoding import encode_text
from dynident.errors import DynidentError
from dynident.export.exported import SMALL, ExportedFile, Links
from dynident.export.names import in_xml_comment, printable, slug
from dynident.export.summary import SIGNS, identification_lines, origin
from dynident.export.ties import held_together
from dynident.identification import Identification
from dynident.robot.model import Joint
from dynident.robot.pinocchio_model import dynamic_parameters
from dynident.robot.urdf_writer import link_names
from dynident.robot.xml_text import Element, number_text, write

HELD: tuple[Role, ...] = ("link", "rotor", "dry", "damping", "stiffness", "at_zero")
"""Roles of the parameters that the format has words for."""
TIMESTEP = 0.001
"""Time step of the simulation in s."""
# The stiffest friction that MuJoCo accepts has a time constant of two steps.
_FRICTION_SOLVER = {"solreffriction": f"{2 * TIMESTEP} 1", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}
_SHORTEST_DRAWN, _THICK = 0.01, 0.08


def to_mjcf(identification: Identification, *, nearest: bool = False) -> ExportedFile:
    """Return the identified model as MJCF.

    Parameters
    ----------
    identification : Identification
    nearest : bool
        If no bodies that can exist have the identified parameters, write the nearest that can.

    Returns
    -------
    ExportedFile

    Raises
    ------
    DynidentError
        As `complete` does; or if a link has no inertia in the model, or a spring pushes away from rest.
    """
    links = Links.of(identification, HELD, nearest=nearest)
    if links.rounding > SMALL:
        # Where right angles are rounded in the description, a rotor is grouped with its link only nearly. The export
        # with the rotor's inertia in the links may then be the more exact one.
        merged = Links.of(identification, HELD, nearest=nearest, rotors_in_links=True)
        links = min(links, merged, key=lambda candidate: candidate.rounding)
    robot = links.robot
    springs = _springs(links)
    tree = robot.tree
    names = link_names(tree)
    bodies: list[Element] = []
    for j, joint in enumerate(tree.joints):
        if not np.any(links.standard.inertias[j]):
            raise DynidentError(
                f"the model has no rigid body on {joint.name}, and MuJoCo moves no link without mass; choose "
                "rigid_body on all joints, or export URDF, C code or JSON",
                pointer="/format",
                title="Not expressible in MJCF",
            )
        body = _body(joint, names[j])
        body.children.append(_joint(joint, links, j, springs.get(joint.name)))
        body.children.append(_inertial(links.standard.inertias[j]))
        body.children.extend(
            _drawn(other.placement[:3, 3])
            for other in tree.joints
            if other.parent == j and np.linalg.norm(other.placement[:3, 3]) > _SHORTEST_DRAWN
        )
        bodies.append(body)
    world = Element("worldbody", {}, 0)
    for joint, body in zip(tree.joints, bodies, strict=True):
        (world if joint.parent < 0 else bodies[joint.parent]).children.append(body)
    root = Element("mujoco", {"model": printable(robot.name)}, 0)
    root.children.extend(
        [
            Element("compiler", {"angle": "radian", "autolimits": "true", "inertiafromgeom": "false"}, 0),
            Element(
                "option",
                {"gravity": number_text(*robot.gravity), "timestep": str(TIMESTEP), "integrator": "implicitfast"},
                0,
            ),
            world,
            *held_together(robot, world, bodies),
            _motors(links),
        ]
    )
    lines = [f"Identified model, {origin()}.", *identification_lines(identification), SIGNS, *links.notes]
    comment = "\n".join(f"  {in_xml_comment(line)}" for line in lines)
    text = f'<?xml version="1.0"?>\n<!--\n{comment}\n-->\n{write(root, indent=True)}'
    return ExportedFile(f"{slug(robot.name)}.xml", "application/xml", encode_text(text), links.notes)


def _body(joint: Joint, name: str) -> Element:
    x, y, z, w = pin.Quaternion(joint.placement[:3, :3]).coeffs()
    return Element(
        "body", {"name": name, "pos": number_text(*joint.placement[:3, 3]), "quat": number_text(w, x, y, z)}, 0
    )


def _joint(joint: Joint, links: Links, j: int, spring: tuple[float, float] | None) -> Element:
    attributes = {
        "name": joint.name,
        "type": "hinge" if joint.kind == "revolute" else "slide",
        "axis": number_text(*joint.axis),
        "damping": number_text(links.standard.viscous[j]),
        "frictionloss": number_text(links.standard.coulomb[j]),
        "armature": number_text(links.standard.rotors[j]),
        **_FRICTION_SOLVER,
    }
    if joint.limits.position is not None:
        attributes["range"] = number_text(*joint.limits.position)
    if spring is not None:
        attributes |= {"stiffness": number_text(spring[0]), "springref": number_text(spring[1])}
    return Element("joint", attributes, 0)


def _inertial(inertial: FloatArray) -> Element:
    body = pin.Inertia.FromDynamicParameters(dynamic_parameters(inertial))
    tensor = body.inertia
    parts = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    attributes = {"pos": number_text(*body.lever), "mass": number_text(body.mass), "fullinertia": number_text(*parts)}
    return Element("inertial", attributes, 0)


def _drawn(end: FloatArray) -> Element:
    """Return a rod to the next joint, for the picture only: it has no mass and no contacts."""
    attributes = {
        "type": "capsule",
        "fromto": number_text(0.0, 0.0, 0.0, *end),
        "size": number_text(_THICK * float(np.linalg.norm(end))),
        "contype": "0",
        "conaffinity": "0",
    }
    return Element("geom", attributes, 0)


def _motors(links: Links) -> Element:
    """Return one motor a joint whose control is the torque, limited if the joint's effort is."""
    actuator = Element("actuator", {}, 0)
    for joint in links.robot.joints:
        attributes = {"name": joint.name, "joint": joint.name}
        if joint.limits.effort is not None:
            attributes["ctrlrange"] = number_text(-joint.limits.effort, joint.limits.effort)
        actuator.children.append(Element("motor", attributes, 0))
    return actuator


def _springs(links: Links) -> dict[str, tuple[float, float]]:
    """Return the stiffness and rest position of the joints that have a spring."""
    spring_parameters: dict[str, dict[Role | None, float]] = {}
    for column, value in zip(links.projected.model.kept, links.standard.values, strict=True):
        role = role_of(column)
        if role in ("stiffness", "at_zero") and not column.runs:
            spring_parameters.setdefault(column.link, {})[role] = float(value)
    springs = {}
    for joint, spring in spring_parameters.items():
        stiffness = spring.get("stiffness", 0.0)
        if stiffness <= 0:
            raise DynidentError(
                f"the spring of {joint} has the stiffness {stiffness:.3g}, and MuJoCo has none that pushes away from "
                "rest; remove the effect, or export C code, a CasADi function or JSON",
                pointer="/format",
                title="Not expressible in MJCF",
            )
        springs[joint] = (stiffness, -spring.get("at_zero", 0.0) / stiffness)
    return springs
