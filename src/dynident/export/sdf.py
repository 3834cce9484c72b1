"""Write the model as SDF for Gazebo and Drake; what they do not read, and what that costs, is in its notes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.effects import Role
from dynident.errors import DynidentError
from dynident.export.comments_and_names import (
    SIGNS,
    describe_identification,
    describe_origin,
    escape_xml_comment,
    make_slug,
    replace_unprintable,
)
from dynident.export.feasible_links_and_joints import ExportedFile, FeasibleLinks, check_is_tree
from dynident.export.urdf import DRAKE_NAMESPACE
from dynident.identification import Identification
from dynident.robot.joint import Joint
from dynident.robot.pinocchio_conversion import to_dynamic_parameters
from dynident.robot.robot_model import Robot
from dynident.robot.urdf_writer import name_links
from dynident.robot.xml_text import format_numbers
from dynident.text_encoding import encode_text

HELD_ROLES: tuple[Role, ...] = ("link", "rotor", "dry", "damping")
"""Roles of the parameters that the format has words for, with Drake's extension for rotors."""
_BASE = "base"
# Elements that SDF places differently since version 1.7, and that Drake reads with this one.
_VERSION = "1.9"


def to_sdf(identification: Identification, *, nearest: bool = False) -> ExportedFile:
    """Return the identified model as SDF.

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
    check_is_tree(identification, "SDF")
    links = FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest, rotors_in_links=True)
    robot, names = links.robot, _Names.from_robot(links.robot)
    notes = (*links.notes, *_write_notes(links, names))
    lines = [f"Identified model, {describe_origin()}.", *describe_identification(identification), SIGNS, *notes]
    comment = "\n".join(f"  {escape_xml_comment(line)}" for line in lines)
    parts = "\n".join(
        f"    {line}" for j, joint in enumerate(robot.joints) for line in _write_link_and_joint(links, j, joint, names)
    )
    text = (
        f'<?xml version="1.0"?>\n<!--\n{comment}\n-->\n'
        f'<sdf version="{_VERSION}" xmlns:drake="{DRAKE_NAMESPACE}">\n'
        f"  <model name={quoteattr(names.model)}>\n"
        f'    <link name="{names.base}"/>\n'
        f'    <joint name="{names.mount}" type="fixed"><parent>world</parent><child>{names.base}</child></joint>\n'
        f"{parts}\n  </model>\n</sdf>\n"
    )
    return ExportedFile(
        f"{make_slug(robot.name)}.sdf", "application/xml", encode_text(text), notes, links.held_out_error
    )


@dataclass(frozen=True)
class _Names:
    """Names in the file: unique, since links and joints share a namespace, and such as the format allows."""

    model: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    base: str
    mount: str

    @classmethod
    def from_robot(cls, robot: Robot) -> _Names:
        """Return the names of a robot; joints keep theirs where the format allows them."""
        [model] = _make_names([robot.name or "robot"])
        first = [*robot.joint_names, _BASE, f"{_BASE}_mount", *name_links(robot)]
        names, n = _make_names(first), robot.n
        return cls(model, tuple(names[:n]), tuple(names[n + 2 :]), *names[n : n + 2])


def _make_names(names: Sequence[str]) -> list[str]:
    """Return unique names without blanks at the ends, without `::`, and other than SDF's own: world, __model__."""
    unique: list[str] = []
    for name in names:
        plain = re.sub(":{2,}", "_", replace_unprintable(name).strip())
        if plain.startswith("__") and plain.endswith("__"):
            plain = plain.strip("_")
        plain = plain or "_"
        while plain in (*unique, "world"):
            plain += "_"
        unique.append(plain)
    return unique


def _write_notes(links: FeasibleLinks, names: _Names) -> list[str]:
    renamed = [f"{old} is {new}" for old, new in zip(links.robot.joint_names, names.joints, strict=True) if old != new]
    notes = [f"SDF does not allow the names of some joints: {', '.join(renamed)}."] if renamed else []
    notes += [f"Drake has no Coulomb friction of joints. {links.describe_loss('<friction>', 'dry')}"]
    if np.any(links.standard.rotors > 0):
        notes += [
            "SDF has no rotor inertia. It is in <drake:rotor_inertia>, unless the link has it already.",
            links.describe_loss("<drake:rotor_inertia>", "rotor"),
        ]
    if not np.allclose(links.robot.gravity, (0.0, 0.0, -9.81)):
        gravity = ", ".join(f"{g:g}" for g in links.robot.gravity)
        notes.append(f"Gravity is a property of the world in SDF: set it to {gravity} m/s² (x, y, z).")
    return notes


def _write_link_and_joint(links: FeasibleLinks, j: int, joint: Joint, names: _Names) -> Iterator[str]:
    parent, link, own = names.base if joint.parent < 0 else names.links[joint.parent], names.links[j], names.joints[j]
    if links.standard.inertias[j, 9] <= 0:
        raise DynidentError(
            f"the model has no mass on {joint.name}, and an SDF needs one; choose rigid_body on all joints, or export "
            "C code, a CasADi function or JSON",
            pointer="/format",
            title="Not expressible in SDF",
        )
    yield f"<link name={quoteattr(link)}>"
    yield f"  <pose relative_to={quoteattr(own)}>0 0 0 0 0 0</pose>"
    yield f"  {_write_inertial(links.standard.inertias[j])}"
    yield "</link>"
    yield f"<joint name={quoteattr(own)} type={quoteattr(joint.kind)}>"
    yield f"  <parent>{escape(parent)}</parent><child>{escape(link)}</child>"
    rotation = pin.rpy.matrixToRpy(joint.placement[:3, :3])
    place = format_numbers(*joint.placement[:3, 3], *rotation)
    yield f"  <pose relative_to={quoteattr(parent)}>{place}</pose>"
    yield f"  <axis><xyz>{format_numbers(*joint.axis)}</xyz>"
    damping, friction = (format_numbers(values[j]) for values in (links.standard.viscous, links.standard.coulomb))
    yield f"    <dynamics><damping>{damping}</damping><friction>{friction}</friction></dynamics>"
    limits = joint.limits
    # Drake takes an effort of zero for a joint without a motor, and -1 for one without a limit.
    bounds = [("effort", -1.0 if limits.effort is None else limits.effort)]
    bounds += [("velocity", limits.velocity)] if limits.velocity else []
    if limits.position is not None:
        bounds += list(zip(("lower", "upper"), limits.position, strict=True))
    inside = "".join(f"<{tag}>{format_numbers(value)}</{tag}>" for tag, value in bounds)
    yield f"    <limit>{inside}</limit></axis>"
    rotor = links.standard.rotors[j]
    if rotor > 0:
        yield f"  <drake:rotor_inertia>{format_numbers(rotor)}</drake:rotor_inertia>"
        yield "  <drake:gear_ratio>1</drake:gear_ratio>"
    yield "</joint>"


def _write_inertial(inertial: FloatArray) -> str:
    body = pin.Inertia.FromDynamicParameters(to_dynamic_parameters(inertial))
    tensor = "".join(
        f"<i{'xyz'[row]}{'xyz'[column]}>{format_numbers(body.inertia[row, column])}</i{'xyz'[row]}{'xyz'[column]}>"
        for row in range(3)
        for column in range(row, 3)
    )
    return (
        f"<inertial><pose>{format_numbers(*body.lever)} 0 0 0</pose><mass>{format_numbers(body.mass)}</mass>"
        f"<inertia>{tensor}</inertia></inertial>"
    )
