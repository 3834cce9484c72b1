"""A robot that stands on two soles: hips that lean it, an arm of two joints with a ball as hand, and a mast."""

from __future__ import annotations

import numpy as np

SOLE = np.array([[x, y, -0.02] for x in (-0.06, 0.14) for y in (-0.05, 0.05)])
FEET = ("left_foot", "right_foot")
HOME = (0.1, 0.4, 0.1, 0.2, -0.3)
"""Of left hip, mast, right hip, shoulder and elbow. The hips lean the trunk forwards by 0.1 rad, so that the ground is
not level in its frame."""
LEGS = [0, 2]


def write_link(name: str, mass: float, centre: str, more: str = "") -> str:
    inertia = f'<inertia ixx="{0.01 * mass}" iyy="{0.012 * mass}" izz="{0.008 * mass}" ixy="0.001" ixz="0" iyz="0"/>'
    inertial = f'<inertial><origin xyz="{centre}"/><mass value="{mass}"/>{inertia}</inertial>'
    return f'<link name="{name}">{inertial}{more}</link>'


def write_joint(name: str, parent: str, child: str, place: str, axis: str, effort: float) -> str:
    limits = f'<limit lower="-1.5" upper="1.5" velocity="4" effort="{effort}"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
    return f'<joint name="{name}" type="revolute">{ends}{limits}</joint>'


BOX = '<collision><origin xyz="0.04 0 -0.01"/><geometry><box size="0.2 0.1 0.02"/></geometry></collision>'
BALL = '<collision><origin xyz="0.55 0 0"/><geometry><sphere radius="0.04"/></geometry></collision>'
STANDER = "".join(
    [
        '<robot name="stander">',
        write_link("trunk", 9.0, "0.01 0 0.1"),
        write_link("left_foot", 1.0, "0.02 0 0.2", BOX),
        write_link("right_foot", 1.0, "0.02 0 0.2", BOX),
        write_link("upper_arm", 3.5, "0.12 0 0.01"),
        write_link("lower_arm", 3.0, "0.15 0.01 0", BALL),
        write_link("mast", 1.0, "0 0 0.2"),
        write_joint("left_hip", "trunk", "left_foot", "0 0.12 -0.5", "0 1 0", 60),
        write_joint("right_hip", "trunk", "right_foot", "0 -0.12 -0.5", "0 1 0", 60),
        write_joint("shoulder", "trunk", "upper_arm", "0 0 0.3", "0 0.8 0.6", 40),
        write_joint("elbow", "upper_arm", "lower_arm", "0.3 0 0", "0 1 0", 20),
        write_joint("mast_joint", "trunk", "mast", "0 0 0.3", "1 0 0", 20),
        "</robot>",
    ]
)


def write_leg(side: str, offset: float) -> list[str]:
    """Return the links and joints of a leg of six joints, from the trunk down to a foot with a sole."""
    parts = [
        ("hip_yaw", f"0 {offset} -0.1", "0 0 1", 0.8, "0.01 0 -0.02"),
        ("hip_roll", "0 0 -0.04", "1 0 0", 0.9, "0 0.01 -0.03"),
        ("thigh", "0 0 0", "0 1 0", 2.5, "0.02 0.01 -0.15"),
        ("shank", "0 0 -0.3", "0 1 0", 1.8, "0.01 -0.01 -0.14"),
        ("ankle", "0 0 -0.3", "0 1 0", 0.5, "0 0 0"),
        ("foot", "0 0 0", "1 0 0", 0.6, "0.03 0 -0.01"),
    ]
    text, parent = [], "trunk"
    for name, place, axis, mass, centre in parts:
        child = f"{side}_{name}"
        text.append(write_link(child, mass, centre, BOX if name == "foot" else ""))
        text.append(write_joint(f"{child}_joint", parent, child, place, axis, 90))
        parent = child
    return text


SQUATTER = "".join(
    [
        '<robot name="squatter">',
        write_link("trunk", 9.0, "0.01 0 0.1"),
        *write_leg("left", 0.1),
        *write_leg("right", -0.1),
        write_link("upper_arm", 2.0, "0.12 0 0.01"),
        write_link("lower_arm", 1.5, "0.15 0.01 0", BALL),
        write_joint("shoulder", "trunk", "upper_arm", "0 0 0.3", "0 0.8 0.6", 40),
        write_joint("elbow", "upper_arm", "lower_arm", "0.3 0 0", "0 1 0", 20),
        "</robot>",
    ]
)
"""A robot whose legs can keep their soles in place while its trunk moves, with an arm of two joints."""
