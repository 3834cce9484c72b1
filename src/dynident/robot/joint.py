"""`Joint`: kind, parent, axis, limits, and from which range on these limit nothing; contacts; limbs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from dynident.array_types import FloatArray
from dynident.robot.limits_and_drives import Limits
from dynident.text_encoding import escape_surrogates

JointKind = Literal["revolute", "prismatic"]


@dataclass(frozen=True)
class Contact:
    """Where the surroundings may act on a robot by a force that nobody measures.

    Parameters
    ----------
    link : str
        Name of the link.
    point : (x, y, z), optional
        Point of the link, in its frame (m), where a force acts, as on the foot of a quadruped; by default a force and
        a moment act on the link, as on a sole.
    radius : float
        Radius (m) of a ball around the point that rolls on the ground: the force acts so far below the point.
    lift : float, optional
        On level ground, how far (m) the contact is above the lowest one of the robot where it surely touches nothing;
        by default it may touch at any height. Without a point, the height is that of the link's frame. From twice
        this height on, the contact is not eliminated.

    Examples
    --------
    >>> from dynident.robot.contacts import parse_contact
    >>> parse_contact("calf@0,0,-0.21,0.02^0.03")
    Contact(link='calf', point=(0.0, 0.0, -0.21), radius=0.02, lift=0.03)
    """

    link: str
    point: tuple[float, float, float] | None = None
    radius: float = 0.0
    lift: float | None = None

    def __str__(self) -> str:
        numbers = () if self.point is None else (*self.point, *((self.radius,) if self.radius else ()))
        place = f"@{','.join(map(repr, numbers))}" if numbers else ""
        return f"{self.link}{place}{'' if self.lift is None else f'^{self.lift!r}'}"


WIDEST_RANGE = {"revolute": 20 * math.pi, "prismatic": 1000.0}
"""Widest range of positions, rad or m, that counts as a limit: the last joint of some arms makes a few turns."""


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint and the link that it moves.

    Parameters
    ----------
    name : str
        Name of the joint.
    kind : {"revolute", "prismatic"}
        Whether it turns or slides.
    parent : int
        Index of the antecedent joint; -1 for the base.
    placement : ndarray (4, 4)
        Takes coordinates of the joint's frame at q = 0 to the antecedent's frame (m).
    axis : ndarray (3,)
        Unit vector in the joint's own frame about which it turns or along which it slides.
    limits : Limits
        Its limits, as far as they are known.
    link : str
        Name of the link, where the description has one.
    """

    name: str
    kind: JointKind
    parent: int
    placement: FloatArray
    axis: FloatArray
    limits: Limits = field(default_factory=Limits)
    link: str = ""

    def __post_init__(self) -> None:
        # Pinocchio, Arrow and matplotlib take no text that has no encoding.
        object.__setattr__(self, "name", escape_surrogates(self.name))
        object.__setattr__(self, "link", escape_surrogates(self.link))

    @property
    def reach(self) -> tuple[float, float] | None:
        """Lowest and highest position in rad or m; None where no limit is known, or it is wider than any machine's."""
        return None if self.has_limitless_range else self.limits.position

    @property
    def has_limitless_range(self) -> bool:
        """Whether the position limits are wider than those of any machine, as some files write continuous joints."""
        position = self.limits.position
        # Negated, so that a range that is not a number counts as limitless.
        return position is not None and not position[1] - position[0] <= WIDEST_RANGE[self.kind]

    @property
    def effort_unit(self) -> str:
        """Unit of this joint's torque or force."""
        return "N m" if self.kind == "revolute" else "N"


_FEW_MISSING = 3
"""Joints that are left out are named instead of the others if there are at most so many, and more of the others."""


MANY_NAMES = 6
"""More names than these are no help in a list beside others: it says how many joints there are."""


def join_joint_names(joints: Sequence[str], all_joints: Sequence[str], most: int | None = None) -> str:
    """Join the names of joints: "all joints", "all but knee", or the names, left and right ones together.

    Parameters
    ----------
    joints : sequence of str
        Names of the joints.
    all_joints : sequence of str
        All joints of the robot.
    most : int, optional
        Of more names than these, left and right ones together, only the number of joints is given: "15 of 29 joints".

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
    names = _merge_sides(joints)
    return ", ".join(names) if most is None or len(names) <= most else f"{len(joints)} of {len(all_joints)} joints"


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


@dataclass(frozen=True)
class Limb:
    """A chain of joints between two branchings of a robot's tree, or the whole tree.

    Parameters
    ----------
    title : str
        In words: "left_hip_pitch to left_ankle_roll, 6 joints".
    joints : tuple of str
        Names of its joints, from the base outwards.
    parent : int, optional
        Which limb of the list it branches off from; none for the whole robot.
    """

    title: str
    joints: tuple[str, ...]
    parent: int | None


def list_limbs(antecedents: Mapping[str, str | None], n_base: int = 0) -> list[Limb]:
    """List the limbs of a robot: the whole robot first, and each limb after the one that it branches off from.

    Parameters
    ----------
    antecedents : mapping of str to str or None
        The preceding joint of every joint, in the robot's order; none on the base.
    n_base : int
        Number of coordinates of a moving base, which are the first joints. They belong to the whole robot alone, and
        are not counted: they are no joints to a user.

    Returns
    -------
    list of Limb
        Empty for a robot that does not branch: there is nothing to choose from.
    """
    names = list(antecedents)
    base, own = names[:n_base], names[n_base:]
    following: dict[str | None, list[str]] = {}
    for joint in own:
        antecedent = antecedents[joint]
        following.setdefault(None if antecedent in base else antecedent, []).append(joint)
    ending = _find_common_ending(own)
    limbs = [Limb(f"all {len(own)} joints", tuple(names), None)]
    # The last one comes first from the list, so that limbs keep the robot's order.
    beginnings = [(first, 0) for first in reversed(following.get(None, []))]
    while beginnings:
        first, parent = beginnings.pop()
        chain = [first]
        while len(following.get(chain[-1], ())) == 1:
            chain += following[chain[-1]]
        ends = [name.removesuffix(ending) for name in (chain[0], chain[-1])]
        title = ends[0] if len(chain) == 1 else f"{' to '.join(ends)}, {len(chain)} joints"
        limbs.append(Limb(title, tuple(chain), parent))
        beginnings += [(branch, len(limbs) - 1) for branch in reversed(following.get(chain[-1], []))]
    return limbs if len(limbs) > 2 else []


def _find_common_ending(names: Sequence[str]) -> str:
    """Return the last word of all names, such as "_joint"; "" where they do not share it."""
    ending = "".join(names[0].rpartition("_")[1:]) if names else ""
    return ending if all(name.endswith(ending) and name != ending for name in names) and "_" in ending else ""
