"""URDF texts of small machines that exercise one thing each."""

from __future__ import annotations

BODY = (
    '<inertial><origin xyz="0.1 0.02 -0.03" rpy="0.1 0.2 0.3"/><mass value="2"/>'
    '<inertia ixx="0.1" ixy="0.01" ixz="-0.02" iyy="0.2" iyz="0.03" izz="0.25"/></inertial>'
)
LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="4"/>'


def link(name: str, inertial: str = BODY) -> str:
    return f'<link name="{name}">{inertial}</link>\n'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "", limit: str = LIMIT) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}\n{inside}{limit}</joint>\n'


def machine(*parts: str) -> str:
    return '<robot name="machine">\n' + "".join(parts) + "</robot>\n"


def one_joint(kind: str = "revolute", inside: str = "", limit: str = LIMIT) -> str:
    return machine(link("base", ""), link("arm"), joint("j", "base", "arm", kind, inside, limit))


EVERY_KIND = machine(
    link("base"),
    link("column"),
    link("flange"),
    link("boom"),
    link("slider"),
    link("left"),
    link("right"),
    link("tool"),
    joint("turn", "base", "column", "continuous", '<origin xyz="0 0 0.4" rpy="0.3 -0.2 0.1"/><axis xyz="0 0 -1"/>'),
    joint("mount", "column", "flange", "fixed", '<origin xyz="0.1 -0.2 0.3" rpy="0.7 0.1 -1.2"/>', ""),
    joint("lift", "flange", "boom", "revolute", '<origin xyz="0.2 0 0" rpy="1.5 0 0"/><axis xyz="1 2 3"/>'),
    joint("slide", "boom", "slider", "prismatic", '<origin xyz="0 0.3 0" rpy="0 0.4 0"/><axis xyz="0 -0.6 0.8"/>'),
    joint("left_turn", "slider", "left", "revolute", '<origin xyz="0 0.3 0.1"/><axis xyz="0 1 0"/>'),
    joint("right_turn", "slider", "right", "continuous", '<origin xyz="0 -0.3 0.1"/><axis xyz="1 0 1"/>'),
    joint("right_slide", "right", "tool", "prismatic", '<axis xyz="1 0 0"/>'),
)
"""A tree with turned axes of every kind, unlimited joints and a fixed joint in between."""
EVERY_KIND_JOINTS = ("turn", "lift", "slide", "left_turn", "right_turn", "right_slide")
