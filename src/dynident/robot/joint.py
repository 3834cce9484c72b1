"""A joint of a robot: its kind, its place in the tree, its axis and its limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from dynident.array_types import FloatArray
from dynident.encoding import escape_surrogates
from dynident.robot.limits import Limits

JointKind = Literal["revolute", "prismatic"]

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
