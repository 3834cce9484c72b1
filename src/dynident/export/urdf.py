"""Write the identified model as URDF: the user's own file with inertias and friction replaced.

Meshes, colours, transmissions, comments and vendor extensions stay. Links that are fixed to a moving link have no
inertia of their own afterwards: only the inertia of all of them together was identified, and the moving link has it.
Joints that were locked during the identification become fixed joints at the positions where they were locked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from xml.dom import minidom

import numpy as np
import pinocchio as pin

from dynident.array_types import FloatArray
from dynident.effects import Role
from dynident.export.comments_and_names import (
    SIGNS,
    describe_identification,
    describe_origin,
    escape_xml_comment,
    make_slug,
)
from dynident.export.feasible_links_and_joints import ExportedFile, FeasibleLinks
from dynident.identification import Identification
from dynident.robot import urdf_from_robot
from dynident.robot.pseudo_inertia import DescriptionUnits, find_description_units
from dynident.robot.urdf_writer import build_inertial
from dynident.robot.xml_text import Element, format_numbers, write_xml
from dynident.text_encoding import encode_text

HELD_ROLES: tuple[Role, ...] = ("link", "rotor", "dry", "damping")
"""Roles of the parameters that the format has words for."""
DRAKE_NAMESPACE = "http://drake.mit.edu"
"""XML namespace of Drake's extensions of URDF and SDF."""
ROTOR_TAG = "dynident_rotor"
"""Child of a `<joint>` whose attribute `inertia` is the rotor's, seen at the joint; URDF itself has no such element."""
_USUAL_TRANSMISSION = "transmission_interface/SimpleTransmission"
_IN_UNITS = ("value", "xyz", *(f"i{axes}" for axes in ("xx", "xy", "xz", "yy", "yz", "zz")))
_ONLY_WHERE_MOVING = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")


def to_urdf(identification: Identification, *, nearest: bool = False) -> ExportedFile:
    """Return the identified model as URDF.

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
        As `complete_parameters` does.
    """
    links = FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest, rotors_in_links=True)
    robot = links.robot
    notes = (*links.notes, *_write_notes(links))
    text = robot.description.content if robot.description.format == "urdf" else urdf_from_robot(robot)
    tree = _EditedUrdf(text, robot.locked_joints)
    units = find_description_units(robot.tree)
    if units is not None:
        # The identified links are in SI units; the base, of which nothing is identified, has to follow.
        tree.scale_inertials(units)
        notes = (f"In the description, {units}; all of this file is in SI units.", *notes)
    for j, joint in enumerate(robot.tree.joints):
        moving = tree.get_child(joint.name)
        # The inertia of all links that move as one body was identified together, and stands in the moving one.
        for name in tree.list_fixed_links(moving):
            tree.set_inertial(name, None)
        inertial = links.standard.inertias[j]
        tree.set_inertial(moving, build_inertial(inertial, moving) if np.any(inertial) else None)
        tree.set_drive(joint.name, links.standard.viscous[j], links.standard.coulomb[j], links.standard.rotors[j])
        # Drake moves only joints that have an actuator: either all get one, or none.
        tree.set_drake_rotor(joint.name, links.standard.rotors[j] if np.any(links.standard.rotors) else None)
    tree.fix_locked_joints()
    tree.insert_comment(
        [f"Identified model, {describe_origin()}.", *describe_identification(identification), SIGNS, *notes]
    )
    return ExportedFile(
        f"{make_slug(robot.name)}.urdf", "application/xml", encode_text(tree.to_text()), notes, links.held_out_error
    )


def _write_notes(links: FeasibleLinks) -> list[str]:
    robot, notes = links.robot, []
    rotors = [
        f"{joint.name} {rotor:.6g}"
        for joint, rotor in zip(robot.tree.joints, links.standard.rotors, strict=True)
        if rotor > 0
    ]
    if rotors:
        notes.append(
            f"URDF has no rotor inertia; this file stores it in <{ROTOR_TAG} inertia> of each joint, and for Drake in "
            "<drake:rotor_inertia>. Programs that do not read these tags leave out its torque, inertia times "
            f"acceleration (kg m² or kg): {', '.join(rotors)}. {links.describe_loss('them', 'rotor')}"
        )
    if np.any(links.standard.coulomb > 0):
        notes.append(f"Drake has no Coulomb friction of joints. {links.describe_loss('friction', 'dry')}")
    if robot.locked_joints and robot.description.format == "urdf":
        names = ", ".join(f"{name} at {value:g}" for name, value in robot.locked_joints.items())
        notes.append(f"Joints that were locked during the identification are fixed in this file: {names}.")
    if not np.allclose(robot.gravity, (0.0, 0.0, -9.81)):
        notes.append(
            f"URDF has no gravity; the model was identified with {', '.join(f'{g:g}' for g in robot.gravity)} m/s² "
            "(x, y, z)."
        )
    return notes


class _EditedUrdf:
    """A URDF that is edited in place; everything else stays as it was written."""

    def __init__(self, text: str, locked: Mapping[str, float]) -> None:
        # The text is decoded already: its declaration may name another encoding, and would mislead the parser.
        declared = re.sub(r"^\ufeff?\s*<\?xml[^>]*\?>", "", text)
        # The standard library's DOM keeps comments, order and unknown elements, which a parser of URDF would drop.
        self._document = minidom.parseString(declared.strip().encode(errors="replace"))
        self._root = _get_root(self._document)
        self._joints = {joint.getAttribute("name"): joint for joint in self._list_children(self._root, "joint")}
        self._links = {link.getAttribute("name"): link for link in self._list_children(self._root, "link")}
        self._locked = {name: value for name, value in locked.items() if name in self._joints}

    def get_child(self, joint: str) -> str:
        """Return the link that a joint moves."""
        return self._get_end(self._joints[joint], "child")

    def list_fixed_links(self, link: str) -> list[str]:
        """Return the links that move with a link as one body, without the link itself."""
        links: list[str] = []
        for joint in self._joints.values():
            rigid = joint.getAttribute("type") == "fixed" or joint.getAttribute("name") in self._locked
            if rigid and self._get_end(joint, "parent") == link:
                child = self._get_end(joint, "child")
                links += [child, *self.list_fixed_links(child)]
        return links

    def set_inertial(self, link: str, inertial: Element | None) -> None:
        """Replace the inertia of a link, or remove it."""
        self._remove(self._links[link], ("inertial",))
        if inertial is not None:
            self._add(self._links[link], inertial)

    def scale_inertials(self, units: DescriptionUnits) -> None:
        """Bring masses, their centres and inertias of all links to SI units."""
        factors = {"mass": units.mass, "origin": units.moment / units.mass, "inertia": units.inertia}
        for link in self._links.values():
            for inertial in self._list_children(link, "inertial"):
                for tag, factor in factors.items():
                    for element in self._list_children(inertial, tag):
                        for name, value in list(element.attributes.items()):
                            if name in _IN_UNITS:
                                element.setAttribute(name, format_numbers(*(factor * _parse_numbers(value))))

    def set_drive(self, joint: str, damping: float, friction: float, rotor: float) -> None:
        """Set the friction of a joint, and its rotor's inertia if it has any."""
        element = self._joints[joint]
        self._remove(element, (ROTOR_TAG,))
        dynamics = self._list_children(element, "dynamics")
        attributes = dict(dynamics[0].attributes.items()) if dynamics else {}
        self._remove(element, ("dynamics",))
        attributes |= {"damping": format_numbers(damping), "friction": format_numbers(friction)}
        self._add(element, Element("dynamics", attributes, 0))
        if rotor:
            self._add(element, Element(ROTOR_TAG, {"inertia": format_numbers(rotor)}, 0))

    def set_drake_rotor(self, joint: str, rotor: float | None) -> None:
        """Set the rotor's inertia as Drake reads it, in the actuator of the joint's transmission; None removes it."""
        tags = ("drake:rotor_inertia", "drake:gear_ratio")
        transmissions = [
            element
            for element in self._list_children(self._root, "transmission")
            # One of several joints, as in a differential wrist, has no rotor of its own there, and Drake ignores it.
            if [child.getAttribute("name") for child in self._list_children(element, "joint")] == [joint]
        ]
        actuators = [actuator for element in transmissions for actuator in self._list_children(element, "actuator")]
        for actuator in actuators:
            self._remove(actuator, tags)
        for element in transmissions:
            # Some files leave out the type, and Drake reads none of them.
            if not element.hasAttribute("type") and not self._list_children(element, "type"):
                self._append(element, "type", {}, _USUAL_TRANSMISSION)
        if rotor is None:
            return
        self._root.setAttribute("xmlns:drake", DRAKE_NAMESPACE)
        if not transmissions:
            transmissions.append(self._append(self._root, "transmission", {"name": f"{joint}_transmission"}))
            self._append(transmissions[0], "type", {}, _USUAL_TRANSMISSION)
            self._append(transmissions[0], "joint", {"name": joint})
        if not actuators:
            actuators.append(self._append(transmissions[0], "actuator", {"name": f"{joint}_motor"}))
        # The identified inertia is that at the joint, behind the gear.
        for tag, value in zip(tags, (rotor, 1.0), strict=True):
            self._append(actuators[0], tag, {"value": format_numbers(value)})

    def _append(
        self, parent: minidom.Element, tag: str, attributes: Mapping[str, str], text: str = ""
    ) -> minidom.Element:
        """Add an element as the last child of another, and return it."""
        element = self._document.createElement(tag)
        for name, value in attributes.items():
            element.setAttribute(name, value)
        if text:
            element.appendChild(self._document.createTextNode(text))
        parent.appendChild(element)
        parent.appendChild(self._document.createTextNode("\n"))
        return element

    def fix_locked_joints(self) -> None:
        """Make every locked joint a fixed one at the place where it was locked."""
        for name, value in self._locked.items():
            joint = self._joints[name]
            if joint.getAttribute("type") == "fixed":
                continue
            # A fixed joint has no motion: the position at which it was locked goes into its origin.
            placement = self._read_placement(joint) * self._read_motion(joint, value)
            self._remove(joint, (*_ONLY_WHERE_MOVING, "origin"))
            joint.setAttribute("type", "fixed")
            place = {
                "xyz": format_numbers(*placement.translation),
                "rpy": format_numbers(*pin.rpy.matrixToRpy(placement.rotation)),
            }
            self._add(joint, Element("origin", place, 0))

    def insert_comment(self, lines: Iterable[str]) -> None:
        """Insert lines as a comment at the head of the robot."""
        text = "\n".join(f"    {escape_xml_comment(line)}" for line in lines)
        first = self._root.firstChild
        self._root.insertBefore(self._document.createTextNode("\n  "), first)
        self._root.insertBefore(self._document.createComment(f"\n{text}\n  "), first)

    def to_text(self) -> str:
        """Return the text of the file."""
        head = "".join(node.toxml() + "\n" for node in self._document.childNodes if node is not self._root)
        return f'<?xml version="1.0"?>\n{head}{self._root.toxml()}\n'

    @staticmethod
    def _list_children(element: minidom.Element, tag: str) -> list[minidom.Element]:
        return [node for node in element.childNodes if node.nodeType == node.ELEMENT_NODE and node.tagName == tag]

    def _get_end(self, joint: minidom.Element, end: str) -> str:
        return str(self._list_children(joint, end)[0].getAttribute("link"))

    def _remove(self, element: minidom.Element, tags: tuple[str, ...]) -> None:
        for tag in tags:
            for node in self._list_children(element, tag):
                # Remove the line break and indentation before the element, too.
                before = node.previousSibling
                if before is not None and before.nodeType == before.TEXT_NODE and not before.data.strip():
                    element.removeChild(before)
                element.removeChild(node)

    def _add(self, element: minidom.Element, new: Element) -> None:
        """Insert an element as the first child of a link or joint."""
        indented = write_xml(new, indent=True, depth=2).strip()
        node = self._document.importNode(_get_root(minidom.parseString(indented)), True)
        if not element.childNodes:
            element.appendChild(self._document.createTextNode("\n  "))
        first = element.firstChild
        element.insertBefore(self._document.createTextNode("\n    "), first)
        element.insertBefore(node, first)

    def _read_placement(self, joint: minidom.Element) -> pin.SE3:
        origins = self._list_children(joint, "origin")
        if not origins:
            return pin.SE3.Identity()
        translation = _parse_numbers(origins[0].getAttribute("xyz") or "0 0 0")
        if origins[0].hasAttribute("quat_xyzw"):
            rotation = pin.Quaternion(_parse_numbers(origins[0].getAttribute("quat_xyzw"))).matrix()
        else:
            rotation = pin.rpy.rpyToMatrix(_parse_numbers(origins[0].getAttribute("rpy") or "0 0 0"))
        return pin.SE3(rotation, translation)

    def _read_motion(self, joint: minidom.Element, value: float) -> pin.SE3:
        axes = self._list_children(joint, "axis")
        axis = _parse_numbers(axes[0].getAttribute("xyz")) if axes else np.array([1.0, 0.0, 0.0])
        axis = axis / np.linalg.norm(axis)
        if joint.getAttribute("type") == "prismatic":
            return pin.SE3(np.eye(3), value * axis)
        return pin.SE3(pin.exp3(value * axis), np.zeros(3))


def _get_root(document: minidom.Document) -> minidom.Element:
    root = document.documentElement
    assert root is not None  # an XML document has one
    return root


def _parse_numbers(text: str) -> FloatArray:
    return np.array([float(word) for word in text.split()])
