"""Follow includes of an MJCF; check and reduce its XML before MuJoCo compiles it; the most bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from dynident.errors import DynidentError, Remedy
from dynident.robot.description_formats import BaseKind
from dynident.robot.json_fields import join_names
from dynident.robot.xml_text import DEEPEST, Element, parse_xml, read_root, write_with_line_numbers
from dynident.text_encoding import decode_document

TITLE = "Unusable MJCF"
MOST_BODIES = 2000
_BODY = ("body", "frame", "joint", "inertial", "geom", "site")
_DRIVES = ("motor", "general", "position", "velocity", "intvelocity", "damper")
_ALIKE = ("cylinder", "muscle", "adhesion", "plugin", "dcmotor")
"""Actuators of which only the joint or tendon that they act on is read."""
# Children that are kept of these elements; all other children, and those of other elements, are dropped.
_KEPT = {
    "mujoco": ("compiler", "option", "default", "worldbody", "equality", "tendon", "actuator", "keyframe"),
    "default": ("default", "joint", "geom", "site", *_DRIVES),
    "worldbody": _BODY,
    "body": _BODY,
    "frame": _BODY,
    "equality": ("connect", "weld", "joint", "tendon"),
    "tendon": ("fixed",),
    "fixed": ("joint",),
    "actuator": (*_DRIVES, *_ALIKE),
    "keyframe": ("key",),
}
_COMPILER = ("angle", "autolimits", "eulerseq", "inertiafromgeom", "inertiagrouprange", "boundmass", "boundinertia")
_PLACE = ("name", "class", "pos", "quat", "axisangle", "xyaxes", "zaxis", "euler")
_DRIVE = ("name", "class", "joint", "jointinparent", "tendon", "gear", "forcerange", "forcelimited")
_ATTRIBUTES = {
    "mujoco": ("model",),
    "compiler": (*_COMPILER, "balanceinertia", "settotalmass"),
    "option": ("gravity",),
    "geom": (*_PLACE, "type", "size", "fromto", "mass", "density", "shellinertia", "group", "mesh"),
    "site": _PLACE,
    "key": ("name", "qpos"),
    **dict.fromkeys(_DRIVES, (*_DRIVE, "ctrlrange", "ctrllimited")),
}
"""Attributes that are kept of these elements; other elements keep all of theirs."""
# Elements that MuJoCo expands: from other files, or by repetition.
_MAKES_MORE = ("include", "replicate", "composite", "flexcomp", "attach")

_Fail = Callable[[str, int], DynidentError]


def make_mjcf_error(detail: str, line: int | None, pointer: str) -> DynidentError:
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


def parse_mjcf(
    text: str, pointer: str, locked: Mapping[str, float], base: BaseKind | None = None
) -> tuple[Element, frozenset[str]]:
    """Return the root element reduced to bodies, joints, inertias, equalities, tendons and actuators.

    Bodies, joints and equalities without a name get one. Geometry stays where the mass of a body comes from it.

    Parameters
    ----------
    text : str
        The MJCF.
    pointer : str
        JSON pointer to the text in the caller's request.
    locked : mapping of joint name to position
        Free and ball joints that are locked at 0 are removed: their body is held there, as in a stand.
    base : {"fixed", "floating", "planar"} or None
        How the root body moves; None: it floats if it has a free joint.

    Returns
    -------
    root : Element
        `<mujoco>`.
    clamped : frozenset of str
        Names of the free and ball joints that were removed.

    Raises
    ------
    DynidentError
        The text is not XML (line and column), its root is another element, elements that include others are not
        expanded, a body hangs on a ball joint or floats beside another, or its mass comes from a file (line).
    """

    def fail(detail: str, line: int | None) -> DynidentError:
        return make_mjcf_error(detail, line, pointer)

    if not text.strip():
        raise fail("The MJCF is empty; expected XML whose root is <mujoco>.", None)
    root = parse_xml(text, "An MJCF", pointer, TITLE)
    if root.tag != "mujoco":
        raise fail(f"The root element is <{root.tag}>; an MJCF file needs the root element <mujoco>.", root.line)
    for element in _iter_descendants(root):
        if element.tag in _MAKES_MORE:
            raise fail(
                f"<{element.tag}> adds elements that are not in this text; let MuJoCo write the whole model to one "
                "file (mj_saveLastXML).",
                element.line,
            )
    for equality in (child for part in root.iter_children("equality") for child in part.children):
        if equality.tag not in _KEPT["equality"] and equality.attributes.get("active") != "false":
            raise fail(
                f"<{equality.tag}> is not a supported equality; expected {join_names(_KEPT['equality'])}.",
                equality.line,
            )
    reduced = _reduce_element(root)
    bodies = [element for element in _iter_descendants(reduced) if element.tag == "body"]
    if len(bodies) > MOST_BODIES:
        raise fail(f"The model has {len(bodies)} bodies; at most {MOST_BODIES} are supported.", root.line)
    if not bodies:
        raise fail("The model has no <body>.", root.line)
    _name_all(reduced)
    from_shapes = any(
        compiler.attributes.get("inertiafromgeom") == "true" for compiler in reduced.iter_children("compiler")
    )
    clamped: frozenset[str] = frozenset()
    for world in reduced.iter_children("worldbody"):
        clamped |= _remove_clamped_joints(world, locked, fail)
        _check_bodies(world, base not in (None, "fixed"), from_shapes, fail, may_float=base != "fixed")
    _check_meshes(reduced, fail)
    if clamped:
        # The poses of key frames have numbers for the joints that are left out.
        reduced.children[:] = [child for child in reduced.children if child.tag != "keyframe"]
    return reduced, clamped


def _iter_descendants(element: Element) -> Iterator[Element]:
    for child in element.children:
        yield child
        yield from _iter_descendants(child)


def _reduce_element(element: Element) -> Element:
    """Return the element with the children and attributes that are kept; rarer actuators become general ones."""
    allowed = _ATTRIBUTES.get("general" if element.tag in _ALIKE else element.tag)
    attributes = element.attributes
    if allowed is not None:
        attributes = {name: value for name, value in attributes.items() if name in allowed}
    if element.tag in _ALIKE:
        attributes = {name: attributes[name] for name in ("name", "joint", "tendon") if name in attributes}
    # Free joints stay for now: they are removed where they are locked, and refused by their name elsewhere.
    tags = _KEPT.get(element.tag, ())
    children = [_reduce_element(child) for child in element.children if child.tag in tags or child.tag == "freejoint"]
    return Element("general" if element.tag in _ALIKE else element.tag, dict(attributes), element.line, children)


def _name_all(root: Element) -> None:
    # Names tie everything together later: messages, locked joints, lines of equalities.
    used_names = {element.attributes["name"] for element in _iter_descendants(root) if "name" in element.attributes}

    def name(element: Element, base_name: str) -> str:
        if not element.attributes.get("name"):
            count, candidate = 1, base_name
            while candidate in used_names:
                count += 1
                candidate = f"{base_name}{count}"
            element.attributes["name"] = candidate
            used_names.add(candidate)
        return element.attributes["name"]

    def walk(element: Element, body: str) -> None:
        for child in element.children:
            if child.tag == "body":
                walk(child, name(child, "body"))
            elif child.tag == "frame":
                walk(child, body)
            elif child.tag in ("joint", "freejoint"):
                name(child, f"{body}_joint")

    for world in root.iter_children("worldbody"):
        walk(world, "world")
    for equality in root.iter_children("equality"):
        for number, child in enumerate(equality.children):
            name(child, f"loop{number + 1}")


def _has_several_freedoms(joint: Element) -> bool:
    return joint.tag == "freejoint" or (joint.tag == "joint" and joint.attributes.get("type") in ("free", "ball"))


def _remove_clamped_joints(element: Element, locked: Mapping[str, float], fail: _Fail) -> frozenset[str]:
    """Remove free and ball joints that are locked at 0, and return their names."""
    clamped = [
        joint for joint in element.children if _has_several_freedoms(joint) and joint.attributes["name"] in locked
    ]
    for joint in clamped:
        name = joint.attributes["name"]
        if locked[name] != 0.0:
            detail = f"Joint '{name}' is locked at {locked[name]:g}; a free or ball joint can only be locked at 0."
            raise fail(detail, joint.line)
        element.children.remove(joint)
    inner = [
        _remove_clamped_joints(child, locked, fail) for child in element.children if child.tag in ("body", "frame")
    ]
    return frozenset(joint.attributes["name"] for joint in clamped).union(*inner)


def _is_free(joint: Element) -> bool:
    return joint.tag == "freejoint" or joint.attributes.get("type") == "free"


def _check_bodies(element: Element, moves: bool, from_shapes: bool, fail: _Fail, *, may_float: bool) -> None:
    """Refuse bodies that hang on ball joints, or float if they may not; drop geometry that no mass comes from."""
    for child in element.children:
        owner = f"Body '{element.attributes.get('name', '')}'"
        if _has_several_freedoms(child) and not (may_float and _is_free(child)):
            name = child.attributes["name"]
            if child.attributes.get("type") == "ball":
                problem, alternative = (
                    "is connected by a ball joint",
                    ", or replace it by hinge joints with separate axes",
                )
            else:
                problem, alternative = "floats freely, but the base is stated to be fixed", ""
            lock = Remedy("locked_joints", {name: 0})
            clamped = f"If it was clamped while the robot was recorded, lock the joint: {lock}{alternative}."
            error = fail(f"{owner} {problem}. {clamped}", child.line)
            error.remedies = (lock,)
            raise error
        if child.tag == "body":
            turns = moves or any(
                element_of_body.tag in ("joint", "freejoint") for element_of_body in _iter_body_elements(child)
            )
            _check_bodies(child, turns, from_shapes, fail, may_float=may_float)
        elif child.tag == "frame":
            # Shapes in a frame belong to the body around it, which drops them itself where they do not count.
            inner = replace(child, attributes={"name": element.attributes.get("name", "")})
            _check_bodies(inner, moves, True, fail, may_float=may_float)
    has_inertial = element.tag == "body" and any(
        element_of_body.tag == "inertial" for element_of_body in _iter_body_elements(element)
    )
    # The mass of a body without <inertial> comes from its shapes, and of all bodies where the compiler is told so.
    # The shapes of bodies that cannot move matter to nothing.
    if not moves or (has_inertial and not from_shapes):
        _drop_geometry(element)


def _drop_geometry(element: Element) -> None:
    """Remove the shapes of a body, including those in its frames."""
    element.children[:] = [child for child in element.children if child.tag != "geom"]
    for child in element.iter_children("frame"):
        _drop_geometry(child)


def _iter_body_elements(element: Element) -> Iterator[Element]:
    """Yield the elements that belong to a body itself, in frames or not."""
    for child in element.children:
        if child.tag == "frame":
            yield from _iter_body_elements(child)
        elif child.tag != "body":
            yield child


def _check_meshes(reduced: Element, fail: _Fail) -> None:
    """Refuse meshes whose mass counts, and replace massless ones by spheres: their files are not read."""
    for element in [reduced, *_iter_descendants(reduced)]:
        for geom in element.iter_children("geom"):
            mesh = geom.attributes.pop("mesh", None)
            massless = "0" in (geom.attributes.get("mass"), geom.attributes.get("density"))
            if element.tag == "default" or mesh is None:
                continue
            if not massless:
                raise fail(
                    f"The mass of its body comes from the mesh '{mesh}', and mesh files are not read: add the "
                    "<inertial> of the body. Its mass, pos, quat and diaginertia are body_mass, body_ipos, body_iquat "
                    "and body_inertia of mujoco.MjModel.from_xml_path, which reads the meshes.",
                    geom.line,
                )
            # Without mass its size has no effect on the dynamics.
            geom.attributes.update(type="sphere", size="1")


def has_includes(content: str) -> bool:
    """Return whether the content of a file is an MJCF model that includes other files."""
    return "<include" in content and (root := read_root(content)) is not None and root.tag == "mujoco"


def expand_includes(path: Path, content: str, pointer: str = "") -> str:
    """Return an MJCF model with the elements of the files that it includes; `content` itself where it includes none.

    Parameters
    ----------
    path : Path
        The model's file; names of files are relative to its folder, or else to that of the file that names them.
    content : str
        Of the file.
    pointer : str
        JSON pointer to the content in the caller's request.

    Raises
    ------
    DynidentError
        For a file that is missing, is included twice, or is no such XML.
    """
    if not has_includes(content):
        return content
    included = {path.resolve()}

    def expand(element: Element, file: Path, depth: int, line: int) -> list[Element]:
        if depth > DEEPEST:
            raise _include_error(f"line {line}: with what it includes the model is nested more than {DEEPEST} levels")
        if element.tag != "include":
            children = [grown for child in element.children for grown in expand(child, file, depth + 1, line)]
            return [replace(element, children=children, line=line or element.line)]
        # Later messages name lines of the model's own text: of what is included, that of the <include> in it.
        line = line or element.line
        name = element.attributes.get("file", "")
        found = _find_included(name, (path.parent, file.parent))
        if found is None:
            raise _include_error(f"line {line}: the file {name[:100]!r} of this <include> is not there")
        if found in included:
            raise _include_error(f"line {line}: {name} is included twice, or includes itself")
        included.add(found)
        try:
            root = parse_xml(decode_document(found.read_bytes()), "An MJCF", "", TITLE)
        except (DynidentError, OSError, UnicodeDecodeError) as error:
            raise _include_error(f"{name}: {getattr(error, 'detail', error)}") from error
        return [grown for child in root.children for grown in expand(child, found, depth + 1, line)]

    return write_with_line_numbers(expand(parse_xml(content, "An MJCF", pointer, TITLE), path, 1, 0)[0])


def _find_included(name: str, folders: Sequence[Path]) -> Path | None:
    """Return the file that a name means: in the folder of the model, else beside the file that includes it."""
    try:
        return next((file.resolve() for folder in folders if (file := folder / name).is_file()), None)
    except (OSError, ValueError):  # a name that no file can have
        return None


def _include_error(reason: str) -> DynidentError:
    return DynidentError(
        f"{reason}; put it beside the model, or let MuJoCo write the whole model to one file (mj_saveLastXML).",
        title=TITLE,
    )
