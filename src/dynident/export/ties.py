"""Joints that follow others, in the words of MuJoCo."""

from __future__ import annotations

from dynident.robot.model import Robot
from dynident.robot.urdf_xml import Element, number_text

# As hard as a constraint is to be had, so that it hardly gives: two steps' time constant.
_HARD = {"solref": "0.002 1", "solimp": "0.9999 0.9999 0.001 0.5 2"}


def tie_elements(robot: Robot) -> list[Element]:
    """What a machine's `<mujoco>` has beside its bodies: fixed tendons that hold its joints together; none for a tree."""
    linkage = robot.linkage
    if linkage is None:
        return []
    tendons, equality = Element("tendon", {}, 0), Element("equality", {}, 0)
    for j in linkage.passive:
        name = linkage.tree.joint_names[j]
        tendon = Element("fixed", {"name": f"{name}_follows"}, 0)
        tendon.children.append(Element("joint", {"joint": name, "coef": "1"}, 0))
        for k, ratio in zip(linkage.driven, linkage.ratios[j], strict=True):
            if ratio:
                coefficient = number_text(-float(ratio))
                tendon.children.append(
                    Element("joint", {"joint": linkage.tree.joint_names[k], "coef": coefficient}, 0)
                )
        tendons.children.append(tendon)
        # MuJoCo measures a tendon from its length at q = 0.
        offset = f"{number_text(float(linkage.offsets[j]))} 0 0 0 0"
        equality.children.append(
            Element("tendon", {"tendon1": f"{name}_follows", "polycoef": offset, **_HARD}, 0)
        )
    return [tendons, equality]
