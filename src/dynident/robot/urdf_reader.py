"""Read a robot from URDF: check and reduce the XML, fixed and mimic joints; the most links (2,000)."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import pinocchio as pin

from dynident.errors import DynidentError, Remedy
from dynident.robot.description_formats import BASE_JOINTS, UPRIGHT, BaseKind
from dynident.robot.json_fields import join_names
from dynident.robot.limits_and_drives import Drive, Limits
from dynident.robot.linkage import link_joints, lock_followers
from dynident.robot.pinocchio_conversion import ROUNDING_TOLERANCE, DescribedJoints, from_pinocchio, release_base
from dynident.robot.robot_model import Description, Robot, Tie
from dynident.robot.stated_settings import Settings, build_settings
from dynident.robot.xml_text import Element, parse_attribute, parse_xml, write_xml

TITLE = "Unusable URDF"
MOVING = ("revolute", "continuous", "prismatic")
MOST_LINKS = 2000
"""Most links, fixed ones included: Pinocchio walks the tree by recursion, and the stack is limited."""
_SHORTEST_AXIS = 1e-6
"""Shortest axis, and the inverse of the longest: beyond, the direction is lost in rounding."""
_OF_MORE_FREEDOMS = ("floating", "planar", "ball", "spherical")

# What to do with other descriptions, by their root.
_ADVICE = {
    "sdf": " This is an SDF: give the URDF or xacro that it was made from, or convert it.",
    "COLLADA": " This is a mesh: give the URDF that names it.",
}


def make_urdf_error(detail: str, line: int | None, pointer: str) -> DynidentError:
    """Return an error that names the line.

    Parameters
    ----------
    detail : str
        What is wrong, and what to do about it.
    line : int or None
        Line of the text, where it is known.
    pointer : str
        JSON pointer to the text in the caller's request.

    Returns
    -------
    DynidentError
        To be raised.
    """
    return DynidentError(f"line {line}: {detail}" if line else detail, pointer=pointer, title=TITLE)


def parse_urdf(text: str, pointer: str = "") -> Element:
    """Return the root element `<robot>` of a URDF text.

    Parameters
    ----------
    text : str
        The URDF.
    pointer : str
        JSON pointer to the text in the caller's request.

    Returns
    -------
    Element
        With all elements of the text and their lines.

    Raises
    ------
    DynidentError
        The text is not XML (with line and column), is a xacro file, its root is another element, or it has more
        elements, or more deeply nested ones, than any robot needs.
    """
    if not text.strip():
        raise make_urdf_error("The URDF is empty; expected XML whose root is <robot>.", None, pointer)
    root = parse_xml(text, "A URDF", pointer, TITLE)
    if root.tag != "robot":
        raise make_urdf_error(
            f"The root element is <{root.tag}>; a URDF needs the root element <robot>.{_ADVICE.get(root.tag, '')}",
            root.line,
            pointer,
        )
    xacro = next((child for child in root.children if child.tag.startswith("xacro:")), None)
    if xacro is not None:
        raise make_urdf_error(
            f"<{xacro.tag}> is xacro; expand the file first (xacro robot.xacro).", xacro.line, pointer
        )
    return root


def _find_clamped_joints(root: Element, locked: Mapping[str, float], pointer: str) -> frozenset[str]:
    """Return the joints of more than one degree of freedom that are locked, at 0, as a base in a stand is."""
    clamped = set()
    for joint in root.iter_children("joint"):
        name, kind = joint.attributes.get("name", ""), joint.attributes.get("type", "")
        if kind in _OF_MORE_FREEDOMS and name in locked:
            if locked[name] != 0.0:
                detail = (
                    f"Joint '{name}' is {kind} and locked at {locked[name]:g}; it can only be locked at its origin (0)."
                )
                raise make_urdf_error(detail, joint.line, pointer)
            clamped.add(name)
    return frozenset(clamped)


def _find_root_joint(root: Element, base: BaseKind | None, clamped: Collection[str]) -> tuple[str, BaseKind]:
    """Return the floating joint that carries the root link, "" for none, and how the base moves.

    Where the user says nothing of the base (None), the description does; joints in `clamped` are held.
    """
    joints = list(root.iter_children("joint"))
    parents, children = ([_get_end(joint, end) for joint in joints] for end in ("parent", "child"))
    # Not a link of the world that carries more than this joint: the rest would move with it.
    roots = [
        joint.attributes.get("name", "")
        for joint, parent in zip(joints, parents, strict=True)
        if joint.attributes.get("type") == "floating" and parent not in children and parents.count(parent) == 1
    ]
    free = [name for name in roots if name not in clamped]
    if not free or base == "fixed":
        return "", base or "fixed"
    return free[0], base or "floating"


def _check_upright(joint: Element, pointer: str) -> None:
    """Refuse a planar base whose root link is not upright: the first joint's origin is the frame of the base."""
    owner, origin = f"joint '{joint.attributes['name']}'", joint.find_child("origin")
    if origin is None or "rpy" not in origin.attributes:
        return
    rpy = parse_attribute(origin, "rpy", owner, lambda detail, line: make_urdf_error(detail, line, pointer))
    if math.cos(rpy[0]) * math.cos(rpy[1]) < UPRIGHT:
        reason = "tilts the root link, but the z axis of a planar base is vertical"
        raise make_urdf_error(f"The <origin> of {owner} {reason}.", origin.line, pointer)


def _get_end(joint: Element, end: str) -> str:
    element = joint.find_child(end)
    return "" if element is None else element.attributes.get("link", "")


def _find_root_link(root: Element, root_joint: str) -> str:
    """Return the name of the link whose frame is that of the base."""
    joints = list(root.iter_children("joint"))
    if root_joint:
        return next(_get_end(joint, "child") for joint in joints if joint.attributes["name"] == root_joint)
    children = {_get_end(joint, "child") for joint in joints}
    return next(name for link in root.iter_children("link") if (name := link.attributes["name"]) not in children)


def reduce_urdf(root: Element, pointer: str = "", clamped: Collection[str] = (), root_joint: str = "") -> Element:
    """Return the `<robot>` reduced to links, inertias, joints and limits, all of them checked.

    Dropping visual elements and vendor extensions also keeps the URDF parser below from complaining on the console. A
    joint without `<limit>` gets one of zeros, and zeros also replace infinite limits: both mean that no limit is known.
    The joints that mimic joints follow are read by `read_mimics`.

    Parameters
    ----------
    root : Element
        The root element of the URDF.
    pointer : str
        JSON pointer to the text in the caller's request.
    clamped : collection of str
        Joints that become fixed ones.
    root_joint : str
        The floating joint that carries the root link, if any: it becomes a fixed one at the origin, so that the frame
        of the base is that of the link.

    Returns
    -------
    Element
        A root element of its own; elements that stay as they are, such as masses, are shared.

    Raises
    ------
    DynidentError
        For what is not a tree of one base with usable numbers (line).
    """

    def fail(detail: str, line: int) -> DynidentError:
        return make_urdf_error(detail, line, pointer)

    links = dict(_iter_named(root, "link", fail))
    joints = {
        name: replace(joint, attributes={**joint.attributes, "type": "fixed"}) if name in clamped else joint
        for name, joint in _iter_named(root, "joint", fail)
    }
    if root_joint:
        joint = joints[root_joint]
        children = [child for child in joint.children if child.tag != "origin"]
        joints[root_joint] = replace(joint, attributes={**joint.attributes, "type": "fixed"}, children=children)
    if not links:
        raise fail("The robot has no <link>. An SRDF only adds to a URDF: give that.", root.line)
    if len(links) > MOST_LINKS:
        raise fail(f"The robot has {len(links)} links; at most {MOST_LINKS} are supported.", root.line)
    for name, joint in joints.items():
        _check_kind(name, joint, fail)
    _check_tree(joints, links, fail)
    if all(joint.attributes["type"] == "fixed" for joint in joints.values()):
        raise fail("The robot has no moving joint; expected a revolute, continuous or prismatic one.", root.line)
    robot = Element("robot", {"name": root.attributes.get("name", "") or "robot"}, root.line)
    robot.children.extend(_reduce_link(name, link, fail) for name, link in links.items())
    robot.children.extend(_reduce_joint(name, joint, fail) for name, joint in joints.items())
    return robot


def read_mimics(root: Element, pointer: str = "") -> dict[str, Tie]:
    """Return the ties of the mimic joints of a `<robot>`, by name: multiplier (1 by default) and offset (0)."""

    def fail(detail: str, line: int) -> DynidentError:
        return make_urdf_error(detail, line, pointer)

    ties = {}
    for joint in root.iter_children("joint"):
        mimic = joint.find_child("mimic")
        if mimic is None or joint.attributes.get("type") == "fixed":
            continue
        owner = f"joint '{joint.attributes.get('name', '')}'"
        other = mimic.attributes.get("joint", "")
        if not other:
            raise fail(f'The <mimic> of {owner} refers to no joint; expected <mimic joint="…"/>.', mimic.line)
        ratio, offset = (
            _parse_number(mimic, attribute, owner, fail) if attribute in mimic.attributes else usual
            for attribute, usual in (("multiplier", 1.0), ("offset", 0.0))
        )
        ties[joint.attributes.get("name", "")] = Tie({other: ratio}, offset, pointer, mimic.line)
    return ties


_Fail = Callable[[str, int], DynidentError]


def _iter_named(root: Element, tag: str, fail: _Fail) -> Iterator[tuple[str, Element]]:
    first_line: dict[str, int] = {}
    for element in root.iter_children(tag):
        name = element.attributes.get("name", "")
        if not name:
            raise fail(f"A <{tag}> has no name.", element.line)
        if name in first_line:
            raise fail(f"The {tag} name '{name}' is used twice (first on line {first_line[name]}).", element.line)
        if tag == "joint" and name == "universe":
            raise fail("A joint cannot be called 'universe': that is the name of the fixed base.", element.line)
        first_line[name] = element.line
        yield name, element


def _check_kind(name: str, joint: Element, fail: _Fail) -> None:
    if (kind := joint.attributes.get("type", "")) == "fixed":
        return
    if kind in _OF_MORE_FREEDOMS:
        lock = Remedy("locked_joints", {name: 0})
        detail = f"Joint '{name}' is {kind}; only revolute, continuous and prismatic joints can move, and a floating "
        detail += f"joint that carries the root link. If it was clamped while the robot was recorded, lock it: {lock}."
        error = fail(detail, joint.line)
        error.remedies = (lock,)
        raise error
    if kind not in MOVING:
        raise fail(f"Joint '{name}' has the type '{kind}'; expected {join_names((*MOVING, 'fixed'))}.", joint.line)


def _check_tree(joints: dict[str, Element], links: dict[str, Element], fail: _Fail) -> None:
    parent_of: dict[str, tuple[str, str]] = {}
    for name, joint in joints.items():
        parent, child = (_get_linked(name, joint, end, links, fail) for end in ("parent", "child"))
        if child in parent_of:
            raise fail(
                f"Link '{child}' is the child of two joints, '{parent_of[child][1]}' and '{name}'; closed loops are "
                "not supported.",
                joint.line,
            )
        parent_of[child] = (parent, name)
    roots = [name for name in links if name not in parent_of]
    if not roots:
        line = next(iter(joints.values())).line
        raise fail("Every link is the child of a joint: the joints form a loop, and no link is the base.", line)
    if len(roots) > 1:
        raise fail(
            f"{len(roots)} links have no parent ({join_names(roots)}), but a robot has only one base. Connect them by "
            "joints.",
            links[roots[1]].line,
        )
    # One root is no proof of a tree: joints that form a circle have no root. Walk from every link to the base.
    for name, (parent, joint_name) in parent_of.items():
        visited = {name}
        while parent in parent_of:
            if parent in visited:
                raise fail(f"Link '{name}' is connected to a loop of joints, not to the base.", joints[joint_name].line)
            visited.add(parent)
            parent = parent_of[parent][0]


def _get_linked(name: str, joint: Element, end: str, links: dict[str, Element], fail: _Fail) -> str:
    element = joint.find_child(end)
    link = element.attributes.get("link", "") if element is not None else ""
    line = (element or joint).line
    if not link:
        raise fail(f"Joint '{name}' refers to no {end} link; expected <{end} link=\\\"…\\\"/>.", line)
    if link == "world" and end == "parent":
        # Drake's models weld their base to a world that no element describes.
        links.setdefault(link, Element("link", {"name": link}, line))
    if link not in links:
        raise fail(f"The {end} link '{link}' of joint '{name}' does not exist; links: {join_names(links)}.", line)
    return link


def _reduce_link(name: str, link: Element, fail: _Fail) -> Element:
    reduced = Element("link", {"name": name}, link.line)
    inertial = link.find_child("inertial")
    if inertial is None:
        return reduced
    owner = f"link '{name}'"
    mass, inertia = inertial.find_child("mass"), inertial.find_child("inertia")
    if mass is None or inertia is None:
        raise fail(f"The <inertial> of {owner} has no <{'mass' if mass is None else 'inertia'}>.", inertial.line)
    for element, names in ((mass, ("value",)), (inertia, ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))):
        for attribute in names:
            _parse_number(element, attribute, owner, fail)
    if _parse_number(mass, "value", owner, fail) < 0:
        raise fail(
            f"The mass of {owner} is negative: correct it, or leave out this <inertial>, which identification does not "
            "need.",
            mass.line,
        )
    reduced_inertial = Element("inertial", {}, inertial.line)
    reduced_inertial.children.extend([*_check_origin(inertial, owner, fail), mass, inertia])
    reduced.children.append(reduced_inertial)
    return reduced


def _reduce_joint(name: str, joint: Element, fail: _Fail) -> Element:
    owner, kind = f"joint '{name}'", joint.attributes["type"]
    reduced = Element("joint", {"name": name, "type": kind}, joint.line)
    reduced.children.extend(_check_origin(joint, owner, fail))
    reduced.children.extend(child for child in joint.children if child.tag in ("parent", "child"))
    if kind == "fixed":
        return reduced
    axis = joint.find_child("axis")
    if axis is not None:
        length = math.hypot(*parse_attribute(axis, "xyz", owner, fail))
        if not _SHORTEST_AXIS < length < 1.0 / _SHORTEST_AXIS:
            detail = f"The axis of {owner} has no direction (xyz has the length {length:.3g}; give a unit vector)."
            raise fail(detail, axis.line)
        reduced.children.append(axis)
    reduced.children.append(_reduce_limit(joint, owner, fail))
    return reduced


def _reduce_limit(joint: Element, owner: str, fail: _Fail) -> Element:
    element = joint.find_child("limit") or Element("limit", {}, joint.line)
    values = {
        attribute: _parse_number(element, attribute, owner, fail) if attribute in element.attributes else 0.0
        for attribute in ("lower", "upper", "velocity", "effort")
    }
    if values["lower"] > values["upper"]:
        raise fail(f"The lower limit of {owner} is above its upper limit.", element.line)
    bounds = {name: value if math.isfinite(value) else 0.0 for name, value in values.items()}
    # Some exporters write -1 where nothing limits the speed or the torque.
    bounds |= {name: max(bounds[name], 0.0) for name in ("velocity", "effort")}
    # A range that is infinite on one side limits nothing that can be stated: drop both ends.
    if not all(map(math.isfinite, (values["lower"], values["upper"]))):
        bounds["lower"] = bounds["upper"] = 0.0
    return Element("limit", {name: repr(value) for name, value in bounds.items()}, element.line)


def _check_origin(parent: Element, owner: str, fail: _Fail) -> list[Element]:
    origin = parent.find_child("origin")
    if origin is None:
        return []
    for attribute, count in (("xyz", 3), ("rpy", 3), ("quat_xyzw", 4)):
        values = parse_attribute(origin, attribute, owner, fail, count) if attribute in origin.attributes else (0.0,)
        # Between two turns in radians and in degrees: nobody writes such radians.
        if attribute == "rpy" and 4.0 * math.pi < max(map(abs, values)) <= 720.0:
            raise fail(f"The rpy of {owner} seems to be in degrees; a URDF has radians.", origin.line)
    return [origin]


def _parse_number(element: Element, attribute: str, owner: str, fail: _Fail) -> float:
    return parse_attribute(element, attribute, owner, fail, 1)[0]


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
    """Return the robot that a URDF describes.

    Revolute, continuous and prismatic joints about any axis move. The links of fixed and locked joints are merged, with
    their inertias, into the link before. Joints of more than one degree of freedom may be locked at their origin, such
    as a floating base that is clamped in a stand. Mimic joints follow others: their links count, but data, drives and
    limits refer to the joints that they follow (`Robot.linkage`). Joints have Pinocchio's order. Inertial parameters
    are about the origin of the joint's frame. Meshes, colours and vendor extensions are ignored.

    Parameters
    ----------
    name, text : str
        Name of the robot; the URDF.
    limits : mapping of str to Limits, optional
        By joint; they win over the URDF's, field by field. In the URDF, limits of zero or less, or larger than those
        of any machine, count as not stated.
    drives : mapping of str to Drive, optional
        Drive chains [12.17], by joint.
    locked_joints : mapping of str to float, optional
        Positions (rad, m) of joints that no longer move; their links become part of the link before.
    gravity : sequence of float, optional
        Acceleration of gravity in the base frame (m/s²), or the world if it moves; (0, 0, -9.81) by default.
    rounding_tolerance : float
        Constants this near to 0, ±1/2, ±1 are mended, see `dynident.robot.pinocchio_conversion`.
    pointer : str
        JSON pointer to the text in the caller's request.

    Returns
    -------
    Robot
        Joints in Pinocchio's order.

    Raises
    ------
    DynidentError
        If the XML is malformed (line and column), the machine is not a tree of such joints on a fixed base (line,
        joint), or a setting does not fit.
    """
    settings = build_settings(limits, drives, locked_joints, gravity)
    return read_urdf(name, text, settings, rounding_tolerance=rounding_tolerance, pointer=pointer)


def read_urdf(
    name: str,
    text: str,
    settings: Settings,
    base: BaseKind | None = None,
    *,
    rounding_tolerance: float = ROUNDING_TOLERANCE,
    pointer: str = "",
) -> Robot:
    """Return the same robot with settings that are checked, on any base; None: as the URDF says."""
    root = parse_urdf(text, pointer)
    locked_by_user = settings.locked_joints
    clamped = _find_clamped_joints(root, locked_by_user, pointer)
    root_joint, kind = _find_root_joint(root, base, clamped)
    if root_joint and kind == "planar":
        _check_upright(next(j for j in root.iter_children("joint") if j.attributes["name"] == root_joint), pointer)
    tree, ties = reduce_urdf(root, pointer, clamped, root_joint), read_mimics(root, pointer)
    # Clamped joints are fixed ones in the reduced text, so that Pinocchio has none of their names to lock.
    locked = {name: position for name, position in locked_by_user.items() if name not in clamped}
    settings = replace(settings, locked_joints=lock_followers(ties, locked))
    try:
        model = release_base(pin.buildModelFromXML(write_xml(tree)), kind, pointer)
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
            links={
                **{joint: _get_end(element, "child") for joint, element in joints.items()},
                **dict.fromkeys(BASE_JOINTS[kind][-1:], _find_root_link(tree, root_joint)),
            },
            fixed=tuple(joint for joint, element in joints.items() if element.attributes["type"] == "fixed"),
            base=kind,
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
    # Zeros stand for limits that the text does not state, see `reduce_urdf`.
    bounded = joint.attributes["type"] != "continuous" and lower < upper
    return Limits.from_description((lower, upper) if bounded else None, velocity, effort)
