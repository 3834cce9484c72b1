"""Write the model as MJCF for MuJoCo; holds the time step and the settings of its friction.

Friction is MuJoCo's `frictionloss`, a soft constraint. The solver parameters here make it follow sign(q̇) wherever the
speed is above a thousandth of a second times the acceleration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.effects import Role, get_role
from dynident.errors import DynidentError
from dynident.export.comments_and_names import (
    SIGNS,
    describe_identification,
    describe_origin,
    escape_xml_comment,
    make_slug,
    replace_unprintable,
)
from dynident.export.feasible_links_and_joints import SMALL, ExportedFile, FeasibleLinks
from dynident.identification import Identification
from dynident.robot.joint import Joint
from dynident.robot.pinocchio_conversion import to_dynamic_parameters
from dynident.robot.robot_model import Linkage, Robot
from dynident.robot.urdf_writer import name_links
from dynident.robot.xml_text import Element, format_numbers, write_xml
from dynident.text_encoding import encode_text

# The hardest constraint that MuJoCo solves has a time constant of two steps.
_HARD = {"solref": "0.002 1", "solimp": "0.9999 0.9999 0.001 0.5 2"}


def build_constraints(robot: Robot, world: Element, bodies: Sequence[Element]) -> list[Element]:
    """Return the elements of `<mujoco>` that hold dependent joints together; none for a tree.

    Fixed tendons hold tied joints together. Where loops are cut, sites are added to the two `bodies` (those of the
    tree's joints, or the `world`) and connected, or welded if the whole frames coincide.
    """
    linkage = robot.linkage
    if linkage is None:
        return []
    names = linkage.tree.joint_names
    tendons, equality = Element("tendon", {}, 0), Element("equality", {}, 0)
    free = robot.joint_names if linkage.closure is None else linkage.closure.names
    for name in linkage.ties:
        j = names.index(name) if name in names else -1
        if j < 0:
            continue
        tendon = Element("fixed", {"name": f"{name}_follows"}, 0)
        tendon.children.append(Element("joint", {"joint": name, "coef": "1"}, 0))
        for other, ratio in zip(free, linkage.ratios[j], strict=True):
            if ratio:
                tendon.children.append(Element("joint", {"joint": other, "coef": format_numbers(-float(ratio))}, 0))
        tendons.children.append(tendon)
        # MuJoCo measures a tendon from its length at q = 0.
        offset = f"{format_numbers(float(linkage.offsets[j]))} 0 0 0 0"
        equality.children.append(Element("tendon", {"tendon1": f"{name}_follows", "polycoef": offset, **_HARD}, 0))
    for number, loop in enumerate(() if linkage.closure is None else linkage.closure.loops):
        sites = [f"loop{number + 1}_{side}" for side in "ab"]
        for site, end in zip(sites, loop.ends, strict=True):
            x, y, z, w = pin.Quaternion(end.frame[:3, :3]).coeffs()
            place = {"pos": format_numbers(*end.frame[:3, 3]), "quat": format_numbers(w, x, y, z)}
            (world if end.joint < 0 else bodies[end.joint]).children.append(Element("site", {"name": site, **place}, 0))
        kind = "weld" if loop.kind == "full" else "connect"
        equality.children.append(Element(kind, {"site1": sites[0], "site2": sites[1], **_HARD}, 0))
    return [tendons, equality, _build_key_frame(linkage, world)]


def _build_key_frame(linkage: Linkage, world: Element) -> Element:
    """Return a key frame with closed loops: MuJoCo starts at q = 0, where they may be open."""
    frames = Element("keyframe", {}, 0)
    if linkage.closure is not None:
        q = linkage.ratios @ linkage.closure.check() + linkage.offsets
        # MuJoCo orders coordinates by the nesting of bodies, which need not be the tree's own order.
        places = [linkage.tree.joint_names.index(name) for name in _iter_joint_names(world)]
        frames.children.append(Element("key", {"name": "closed", "qpos": format_numbers(*q[places])}, 0))
    return frames


def _iter_joint_names(element: Element) -> Iterator[str]:
    """Yield the names of joints in the order of MuJoCo's coordinates: depth first."""
    for child in element.children:
        if child.tag == "joint":
            yield child.attributes["name"]
        elif child.tag == "body":
            yield from _iter_joint_names(child)


HELD_ROLES: tuple[Role, ...] = ("link", "rotor", "dry", "damping", "stiffness", "at_zero")
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
        The identified model, with the data of its fit.
    nearest : bool
        If no bodies that can exist have the identified parameters, write the nearest that can.

    Returns
    -------
    ExportedFile
        The file, with notes on what it could not hold.

    Raises
    ------
    DynidentError
        As `complete_parameters` does; or if a link has no inertia in the model, or a spring pushes away from rest.
    """
    links = complete_mjcf_links(identification, nearest=nearest)
    content = encode_text(write_mjcf(links))
    return ExportedFile(
        f"{make_slug(links.robot.name)}.xml", "application/xml", content, links.notes, links.held_out_error
    )


def complete_mjcf_links(identification: Identification, *, nearest: bool = False) -> FeasibleLinks:
    """Return the links and joints that the MJCF of a model contains; errors as `to_mjcf`."""
    links = FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest)
    if links.rounding_error > SMALL:
        # Where right angles are rounded in the description, a rotor is grouped with its link only nearly. The export
        # with the rotor's inertia in the links may then be the more exact one.
        merged = FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest, rotors_in_links=True)
        links = min(links, merged, key=lambda candidate: candidate.rounding_error)
    return links


def write_mjcf(links: FeasibleLinks) -> str:
    """Return the MJCF of links and joints.

    Parameters
    ----------
    links : FeasibleLinks
        Links and joints, with the model that they are from.

    Returns
    -------
    str
        The text, with the notes at its head.

    Raises
    ------
    DynidentError
        If a link has no inertia in the model, or a spring pushes away from rest.
    """
    identification, robot = links.identification, links.robot
    springs = _read_springs(links)
    tree = robot.tree
    # MuJoCo has a body of its own that is called world.
    names = [name if name != "world" else f"{name}_link" for name in name_links(tree)]
    bodies: list[Element] = []
    for j, joint in enumerate(tree.joints):
        if not np.any(links.standard.inertias[j]):
            raise DynidentError(
                f"the model has no rigid body on {joint.name}, and MuJoCo cannot move a link without mass; choose "
                "rigid_body on all joints, or export URDF, C code or JSON",
                pointer="/format",
                title="Not expressible in MJCF",
            )
        body = _build_body(joint, names[j])
        body.children.append(_build_joint(joint, links, j, springs.get(joint.name)))
        body.children.append(_build_inertial(links.standard.inertias[j]))
        body.children.extend(
            _build_rod(other.placement[:3, 3])
            for other in tree.joints
            if other.parent == j and np.linalg.norm(other.placement[:3, 3]) > _SHORTEST_DRAWN
        )
        bodies.append(body)
    world = Element("worldbody", {}, 0)
    for joint, body in zip(tree.joints, bodies, strict=True):
        (world if joint.parent < 0 else bodies[joint.parent]).children.append(body)
    root = Element("mujoco", {"model": replace_unprintable(robot.name)}, 0)
    root.children.extend(
        [
            Element("compiler", {"angle": "radian", "autolimits": "true", "inertiafromgeom": "false"}, 0),
            Element(
                "option",
                {"gravity": format_numbers(*robot.gravity), "timestep": str(TIMESTEP), "integrator": "implicitfast"},
                0,
            ),
            world,
            *build_constraints(robot, world, bodies),
            _build_motors(links),
        ]
    )
    lines = [f"Identified model, {describe_origin()}.", *describe_identification(identification), SIGNS, *links.notes]
    comment = "\n".join(f"  {escape_xml_comment(line)}" for line in lines)
    return f'<?xml version="1.0"?>\n<!--\n{comment}\n-->\n{write_xml(root, indent=True)}'


def _build_body(joint: Joint, name: str) -> Element:
    x, y, z, w = pin.Quaternion(joint.placement[:3, :3]).coeffs()
    return Element(
        "body", {"name": name, "pos": format_numbers(*joint.placement[:3, 3]), "quat": format_numbers(w, x, y, z)}, 0
    )


def _build_joint(joint: Joint, links: FeasibleLinks, j: int, spring: tuple[float, float] | None) -> Element:
    attributes = {
        "name": joint.name,
        "type": "hinge" if joint.kind == "revolute" else "slide",
        "axis": format_numbers(*joint.axis),
        "damping": format_numbers(links.standard.viscous[j]),
        "frictionloss": format_numbers(links.standard.coulomb[j]),
        "armature": format_numbers(links.standard.rotors[j]),
        **_FRICTION_SOLVER,
    }
    if joint.limits.position is not None:
        attributes["range"] = format_numbers(*joint.limits.position)
    if spring is not None:
        attributes |= {"stiffness": format_numbers(spring[0]), "springref": format_numbers(spring[1])}
    return Element("joint", attributes, 0)


def _build_inertial(inertial: FloatArray) -> Element:
    body = pin.Inertia.FromDynamicParameters(to_dynamic_parameters(inertial))
    tensor = body.inertia
    parts = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    attributes = {
        "pos": format_numbers(*body.lever),
        "mass": format_numbers(body.mass),
        "fullinertia": format_numbers(*parts),
    }
    return Element("inertial", attributes, 0)


def _build_rod(end: FloatArray) -> Element:
    """Return a rod to the next joint, for the picture only: it has no mass and no contacts."""
    attributes = {
        "type": "capsule",
        "fromto": format_numbers(0.0, 0.0, 0.0, *end),
        "size": format_numbers(_THICK * float(np.linalg.norm(end))),
        "contype": "0",
        "conaffinity": "0",
    }
    return Element("geom", attributes, 0)


def _build_motors(links: FeasibleLinks) -> Element:
    """Return one motor a joint whose control is the torque, limited if the joint's effort is."""
    actuator = Element("actuator", {}, 0)
    for joint in links.robot.joints:
        attributes = {"name": joint.name, "joint": joint.name}
        if joint.limits.effort is not None:
            attributes["ctrlrange"] = format_numbers(-joint.limits.effort, joint.limits.effort)
        actuator.children.append(Element("motor", attributes, 0))
    return actuator


def _read_springs(links: FeasibleLinks) -> dict[str, tuple[float, float]]:
    """Return the stiffness and rest position of the joints that have a spring."""
    spring_parameters: dict[str, dict[Role | None, float]] = {}
    for column, value in zip(links.projected.model.kept, links.standard.values, strict=True):
        role = get_role(column)
        if role in ("stiffness", "at_zero") and not column.runs:
            spring_parameters.setdefault(column.link, {})[role] = float(value)
    springs = {}
    for joint, spring in spring_parameters.items():
        stiffness = spring.get("stiffness", 0.0)
        if stiffness <= 0:
            raise DynidentError(
                f"the spring of {joint} has the stiffness {stiffness:.3g}, and MuJoCo has no spring with negative "
                "stiffness; remove the effect, or export C code, a CasADi function or JSON",
                pointer="/format",
                title="Not expressible in MJCF",
            )
        # The model states stiffness q + at_zero, and MuJoCo wants stiffness (q - rest).
        springs[joint] = (stiffness, -spring.get("at_zero", 0.0) / stiffness)
    return springs
