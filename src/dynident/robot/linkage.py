"""Machines whose joints are not all free: which joints of the tree are driven, and what the others follow.

Data, drives and limits are those of the driven joints q_a (n,). The links hang on the tree's joints q (N,), which follow
from them: q = f(q_a), q̇ = G q̇_a with G = ∂f/∂q_a, and the torques of the driven joints are Γ = Gᵀ Γ_tree.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.robot.pointers import listed

if TYPE_CHECKING:
    from dynident.robot.model import Robot


@dataclass(frozen=True)
class Tie:
    """A joint that follows others: q = Σ ratio q_other + offset. `where`, `line`: of the description, for messages."""

    ratios: Mapping[str, float]
    offset: float = 0.0
    where: str = ""
    line: int = 0


@dataclass(frozen=True, eq=False)
class Linkage:
    """The tree that carries the links of a machine, and how it follows the driven joints.

    `driven` (n,) are the driven joints' places among the tree's; q = `ratios` (N, n) q_a + `offsets` (N,).
    """

    tree: Robot
    driven: tuple[int, ...]
    ratios: FloatArray
    offsets: FloatArray
    ties: Mapping[str, Tie] = field(default_factory=dict)

    @property
    def passive(self) -> tuple[int, ...]:
        """Places of the other joints among the tree's."""
        return tuple(j for j in range(self.tree.n) if j not in self.driven)

    def positions(self, q: FloatArray) -> FloatArray:
        """Positions of all joints (m, N) from those of the driven ones (m, n)."""
        return np.asarray(q @ self.ratios.T + self.offsets)

    def rates(self, q: FloatArray) -> FloatArray:
        """G (m, N, n) at driven positions q (m, n)."""
        return np.broadcast_to(self.ratios, (len(q), *self.ratios.shape))

    def motion(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration of all joints (m, N) from those of the driven ones (m, n)."""
        return self.positions(q), dq @ self.ratios.T, ddq @ self.ratios.T

    def movers(self, joint: int) -> tuple[int, ...]:
        """Places among the driven joints of those that a joint of the tree moves with."""
        return tuple(int(j) for j in np.flatnonzero(self.ratios[joint]))


def followers_locked(ties: Mapping[str, Tie], locked: Mapping[str, float]) -> dict[str, float]:
    """The locked joints, and those that stand because all that they follow are locked."""
    found = dict(locked)
    while True:
        more = {
            name: sum(ratio * found[other] for other, ratio in tie.ratios.items()) + tie.offset
            for name, tie in ties.items()
            if name not in found and all(other in found for other in tie.ratios)
        }
        if not more:
            return found
        found |= more


def tied(tree: Robot, ties: Mapping[str, Tie], *, title: str, locked: Mapping[str, float]) -> Robot:
    """The machine of a tree some of whose joints follow others; the tree itself where none does.

    Raises
    ------
    DynidentError
        A joint follows itself, directly or by way of others, or one that does not exist; or a ratio is none.
    """
    ties = {name: tie for name, tie in ties.items() if name in tree.joint_names}
    if not ties:
        return tree
    ratios, offsets = _solved(tree, ties, title, locked)
    driven = tuple(j for j, name in enumerate(tree.joint_names) if name not in ties)
    linkage = Linkage(tree, driven, ratios[:, driven], offsets, ties)
    for name in ties:
        if tree.drives[tree.joint_names.index(name)] != type(tree.drives[0])():
            raise DynidentError(
                f"Joint '{name}' follows other joints, so it has no drive; driven joints: "
                f"{listed(tree.joint_names[j] for j in driven)}.",
                pointer=f"/drives/{name}",
                title=title,
            )
    return driven_robot(linkage)


def driven_robot(linkage: Linkage) -> Robot:
    """The robot whose joints are the driven ones of a linkage; the antecedent of each is the driven joint before it."""
    tree, driven = linkage.tree, linkage.driven
    joints = []
    for j in driven:
        before = [k for k in tree.ancestors(j)[:-1] if k in driven]
        joints.append(replace(tree.joints[j], parent=driven.index(before[-1]) if before else -1))
    return replace(
        tree, joints=tuple(joints), drives=tuple(tree.drives[j] for j in driven), linkage=linkage, inertias=tree.inertias
    )


def check_ratio(value: float) -> bool:
    """Whether a joint can follow another by this ratio."""
    return math.isfinite(value) and value != 0


def _solved(
    tree: Robot, ties: Mapping[str, Tie], title: str, locked: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Ratios (N, N) to the joints that follow none, and offsets (N,)."""
    names = tree.joint_names
    ratios, offsets = np.zeros((tree.n, tree.n)), np.zeros(tree.n)
    done: set[str] = set()

    def solve(name: str, path: tuple[str, ...]) -> None:
        if name in done:
            return
        j = names.index(name)
        tie = ties.get(name)
        if tie is None:
            ratios[j, j] = 1.0
        else:
            if name in path:
                way = " follows ".join(f"'{one}'" for one in (*path[path.index(name) :], name))
                raise _error(f"Joint {way}: a joint cannot follow itself. Leave one of them free.", tie, title)
            offsets[j] = tie.offset
            for other, ratio in tie.ratios.items():
                if other in locked:
                    offsets[j] += ratio * locked[other]
                    continue
                if other not in names:
                    raise _error(
                        f"Joint '{name}' follows '{other}', which is no moving joint; moving joints: "
                        f"{listed(one for one in names if one != name)}.",
                        tie,
                        title,
                    )
                if not check_ratio(ratio):
                    raise _error(
                        f"Joint '{name}' follows '{other}' by {ratio}; expected a number other than 0 (make a joint "
                        "that stands still fixed).",
                        tie,
                        title,
                    )
                solve(other, (*path, name))
                ratios[j] += ratio * ratios[names.index(other)]
                offsets[j] += ratio * offsets[names.index(other)]
        done.add(name)

    for name in names:
        solve(name, ())
    return ratios, offsets


def _error(detail: str, tie: Tie, title: str) -> DynidentError:
    return DynidentError(f"line {tie.line}: {detail}" if tie.line else detail, pointer=tie.where, title=title)
