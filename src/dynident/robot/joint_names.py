"""Names of many joints in few words."""

from __future__ import annotations

from collections.abc import Sequence

_FEW_MISSING = 3
"""Joints that are left out are named instead of the others if there are at most so many, and more of the others."""


def join_joint_names(joints: Sequence[str], all_joints: Sequence[str]) -> str:
    """Join the names of joints: "all joints", "all but knee", or the names, left and right ones together.

    Parameters
    ----------
    joints : sequence of str
        Names of the joints.
    all_joints : sequence of str
        All joints of the robot.

    Returns
    -------
    str
        Their names, in the order of the robot; empty where there are none.
    """
    if len(joints) == len(all_joints) > 1:
        return "all joints"
    missing = [name for name in all_joints if name not in joints]
    if len(missing) <= _FEW_MISSING and len(joints) > 2 * len(missing):
        return f"all but {' and '.join(_merge_sides(missing))}"
    return ", ".join(_merge_sides(joints))


def _merge_sides(joints: Sequence[str]) -> list[str]:
    """Write a left joint whose right one is there as one: "left/right_knee"."""
    names = set(joints)
    merged: list[str] = []
    for name in joints:
        if name.replace("right", "left", 1) != name and name.replace("right", "left", 1) in names:
            continue
        has_both = name.replace("left", "right", 1) != name and name.replace("left", "right", 1) in names
        merged.append(name.replace("left", "left/right", 1) if has_both else name)
    return merged
