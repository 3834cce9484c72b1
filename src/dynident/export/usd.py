"""Write the model as USD (text, .usda) with UsdPhysics, and PhysX's attributes for rotors and friction.

Angles are in degrees, as UsdPhysics wants them. The file needs no library of USD to be written.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.effects import Role
from dynident.errors import DynidentError
from dynident.export.comments_and_names import (
    SIGNS,
    describe_identification,
    describe_origin,
    make_slug,
    replace_unprintable,
)
from dynident.export.feasible_links_and_joints import ExportedFile, FeasibleLinks, check_is_tree
from dynident.identification import Identification
from dynident.robot.joint import Joint
from dynident.robot.pinocchio_conversion import to_dynamic_parameters
from dynident.robot.robot_model import Robot
from dynident.robot.urdf_writer import name_links
from dynident.text_encoding import encode_text

HELD_ROLES: tuple[Role, ...] = ("link", "rotor", "dry", "damping")
"""Roles of the parameters that the format has words for, with PhysX's extension for rotors and friction."""
_BASE = "base"
_DEGREE = np.pi / 180.0


def to_usd(identification: Identification, *, nearest: bool = False) -> ExportedFile:
    """Return the identified model as USD.

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
        As `complete_parameters` does; or if a link has no mass, or joints of the robot follow others.
    """
    check_is_tree(identification, "USD")
    links = FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest)
    robot = links.robot
    for joint, inertial in zip(robot.joints, links.standard.inertias, strict=True):
        if inertial[9] <= 0:
            raise DynidentError(
                f"the model has no mass on {joint.name}, and USD needs one; choose rigid_body on all joints, or export "
                "C code, a CasADi function or JSON",
                pointer="/format",
                title="Not expressible in USD",
            )
    notes = (*links.notes, *_write_notes(links))
    link_names, joint_names = name_prims(robot)
    root = _make_prim_names([robot.name])[0]
    gravity = np.asarray(robot.gravity)
    size = float(np.linalg.norm(gravity))
    lines = [f"Identified model, {describe_origin()}.", *describe_identification(identification), SIGNS, *notes]
    parts: list[str] = []
    frames: list[pin.SE3] = []
    for j, joint in enumerate(robot.joints):
        # Rigid bodies must not be nested in USD: all are children of the robot, at their places where q = 0.
        placed = pin.SE3(joint.placement)
        frames.append(placed if joint.parent < 0 else frames[joint.parent] * placed)
        parts += _write_link(link_names[j], frames[j], links.standard.inertias[j])
        parent = _BASE if joint.parent < 0 else link_names[joint.parent]
        paths = (f"/{root}/{parent}", f"/{root}/{link_names[j]}")
        parts += _write_joint(links, j, joint, joint_names[j], paths)
    text = _HEAD.format(
        comment="\n".join(f"# {replace_unprintable(line)}" for line in lines),
        root=root,
        base=_BASE,
        direction=_write_tuple(gravity / size if size else np.array([0.0, 0.0, -1.0])),
        size=repr(size),
        parts="\n".join(f"    {line}" if line else "" for line in parts),
    )
    return ExportedFile(
        f"{make_slug(robot.name)}.usda", "model/vnd.usda", encode_text(text), notes, links.held_out_error
    )


def _write_notes(links: FeasibleLinks) -> list[str]:
    standard = links.standard
    if not any(np.any(values > 0) for values in (standard.rotors, standard.coulomb, standard.viscous)):
        return []
    return [
        "UsdPhysics has no friction and rotors of joints. This file has them as physxJointAxis attributes, which PhysX "
        "reads.",
        links.describe_loss("them", "rotor", "dry", "damping"),
    ]


def _write_link(name: str, frame: pin.SE3, inertial: FloatArray) -> Iterator[str]:
    body = pin.Inertia.FromDynamicParameters(to_dynamic_parameters(inertial))
    moments, axes = np.linalg.eigh(body.inertia)
    axes = axes * np.sign(np.linalg.det(axes))
    yield f'def Xform "{name}" ('
    yield '    prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]'
    yield ")"
    yield "{"
    yield f"    float physics:mass = {body.mass!r}"
    yield f"    point3f physics:centerOfMass = {_write_tuple(body.lever)}"
    yield f"    float3 physics:diagonalInertia = {_write_tuple(moments)}"
    yield f"    quatf physics:principalAxes = {_write_quaternion(axes)}"
    yield f"    double3 xformOp:translate = {_write_tuple(frame.translation)}"
    yield f"    quatd xformOp:orient = {_write_quaternion(frame.rotation)}"
    yield '    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]'
    yield "}"
    yield ""


def _write_joint(links: FeasibleLinks, j: int, joint: Joint, name: str, paths: tuple[str, str]) -> Iterator[str]:
    revolute = joint.kind == "revolute"
    kind, axis = ("Revolute", "angular") if revolute else ("Prismatic", "linear")
    unit = _DEGREE if revolute else 1.0
    # A joint of USD moves along X, Y or Z of its frame; the frame's X axis is turned into the joint's axis.
    turned = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), np.asarray(joint.axis)).matrix()
    yield f'def Physics{kind}Joint "{name}" ('
    yield f'    prepend apiSchemas = ["PhysxJointAxisAPI:{axis}"]'
    yield ")"
    yield "{"
    yield f"    rel physics:body0 = <{paths[0]}>"
    yield f"    rel physics:body1 = <{paths[1]}>"
    yield f"    point3f physics:localPos0 = {_write_tuple(joint.placement[:3, 3])}"
    yield f"    quatf physics:localRot0 = {_write_quaternion(joint.placement[:3, :3] @ turned)}"
    yield "    point3f physics:localPos1 = (0, 0, 0)"
    yield f"    quatf physics:localRot1 = {_write_quaternion(turned)}"
    yield '    uniform token physics:axis = "X"'
    if joint.limits.position is not None:
        low, high = joint.limits.position
        yield f"    float physics:lowerLimit = {float(low / unit)!r}"
        yield f"    float physics:upperLimit = {float(high / unit)!r}"
    standard = links.standard
    attributes = [
        ("armature", float(standard.rotors[j])),
        ("staticFrictionEffort", float(standard.coulomb[j])),
        ("dynamicFrictionEffort", float(standard.coulomb[j])),
        # N m s/degree: PhysX multiplies the value by 180/pi.
        ("viscousFrictionCoefficient", float(standard.viscous[j] * unit)),
    ]
    if joint.limits.velocity:
        attributes.append(("maxJointVelocity", float(joint.limits.velocity / unit)))
    for attribute, value in attributes:
        yield f"    float physxJointAxis:{axis}:{attribute} = {value!r}"
    yield f"    custom string dynident:joint = {json.dumps(replace_unprintable(joint.name), ensure_ascii=False)}"
    yield "}"
    yield ""


def name_prims(robot: Robot) -> tuple[list[str], list[str]]:
    """Return the names of the prims of links and joints, which also are their names in Isaac."""
    names = _make_prim_names([*name_links(robot), *robot.joint_names])
    return names[: robot.n], names[robot.n :]


def _make_prim_names(names: Sequence[str]) -> list[str]:
    """Return unique names that USD allows for prims: letters, digits, underscores, and no digit first."""
    unique: list[str] = []
    for name in names:
        plain = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in name) or "_"
        if plain[0].isdecimal():
            plain = f"_{plain}"
        while plain in (*unique, _BASE, f"{_BASE}_mount", "scene"):
            plain += "_"
        unique.append(plain)
    return unique


def _write_tuple(values: FloatArray) -> str:
    return f"({', '.join(repr(float(value)) for value in values)})"


def _write_quaternion(rotation: FloatArray) -> str:
    x, y, z, w = pin.Quaternion(np.asarray(rotation)).normalized().coeffs()
    return _write_tuple(np.array([w, x, y, z]))


_HEAD = """\
#usda 1.0
(
    defaultPrim = "{root}"
    metersPerUnit = 1
    kilogramsPerUnit = 1
    upAxis = "Z"
)
{comment}

def Xform "{root}" (
    prepend apiSchemas = ["PhysicsArticulationRootAPI"]
)
{{
    def Xform "{base}" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
    )
    {{
        float physics:mass = 1
        float3 physics:diagonalInertia = (1, 1, 1)
        quatf physics:principalAxes = (1, 0, 0, 0)
    }}

    def PhysicsFixedJoint "{base}_mount"
    {{
        rel physics:body1 = </{root}/{base}>
    }}

{parts}
    def PhysicsScene "scene"
    {{
        vector3f physics:gravityDirection = {direction}
        float physics:gravityMagnitude = {size}
    }}
}}
"""
