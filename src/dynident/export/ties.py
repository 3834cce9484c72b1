"""Write joints that follow others, and closed loops, as elements of MJCF."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pinocchio as pin

from dynident.robot.linkage import Linkage
from dynident.robot.model import Robot
from dynident.robot.xml_text import Element, format_numbers

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
