"""Cut joints: two frames of a tree that coincide, and how far they are apart as an expression of its positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca

from dynident.arrays import FloatArray
from dynident.robot.model import Joint

LoopKind = Literal["planar", "point", "full"]
EQUATIONS = {"planar": 2, "point": 3, "full": 6}
"""How many equations a loop of each kind has."""


@dataclass(frozen=True, eq=False)
class End:
    """One side of a cut joint: the joint of the tree that carries it (-1: the base), and its frame (4, 4) there."""

    joint: int
    frame: FloatArray


@dataclass(frozen=True, eq=False)
class Loop:
    """Two frames that coincide: wholly, in their origins (a ball joint), or in the xy plane of the first (a pin).

    `equations` are those of its kind that count, all of them by default; `where`, `line` its place in the description,
    for messages.
    """

    name: str
    kind: LoopKind
    ends: tuple[End, End]
    where: str = ""
    line: int = 0
    equations: tuple[int, ...] | None = None

    @property
    def count(self) -> int:
        """Number of its equations."""
        return EQUATIONS[self.kind] if self.equations is None else len(self.equations)


def sparse(matrix: FloatArray) -> ca.SX:
    """A matrix as constants, without its zeros."""
    return ca.sparsify(ca.SX(ca.DM(matrix)))


def frames_of_joints(joints: Sequence[Joint], q: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Rotation (3, 3) and origin (3, 1) of every joint's frame in the base frame."""
    frames: list[tuple[ca.SX, ca.SX]] = []
    for index, joint in enumerate(joints):
        rotation, origin = (ca.SX.eye(3), ca.SX(3, 1)) if joint.parent < 0 else frames[joint.parent]
        origin = origin + ca.mtimes(rotation, sparse(joint.placement[:3, 3:]))
        rotation = ca.mtimes(rotation, sparse(joint.placement[:3, :3]))
        axis = sparse(joint.axis[:, None])
        if joint.kind == "prismatic":
            origin = origin + ca.mtimes(rotation, axis) * q[index]
        else:
            along = ca.mtimes(axis, axis.T)
            turn = ca.cos(q[index]) * (ca.SX.eye(3) - along) + ca.sin(q[index]) * ca.skew(ca.densify(axis)) + along
            rotation = ca.mtimes(rotation, ca.sparsify(turn))
        frames.append((rotation, origin))
    return frames


def gap_of(loop: Loop, frames: Sequence[tuple[ca.SX, ca.SX]]) -> ca.SX:
    """How far the two frames of a loop are apart, SX (equations, 1): m, and rad where they coincide wholly."""
    whole = _whole_gap(loop, frames)
    return whole if loop.equations is None else whole[list(loop.equations)]


def _whole_gap(loop: Loop, frames: Sequence[tuple[ca.SX, ca.SX]]) -> ca.SX:
    (turned, first), (other, second) = (_placed(end, frames) for end in loop.ends)
    apart = ca.mtimes(turned.T, second - first)
    if loop.kind == "planar":
        return apart[:2]
    if loop.kind == "point":
        return apart
    between = ca.mtimes(turned.T, other)
    twist = 0.5 * (between - between.T)
    return ca.vertcat(apart, twist[2, 1], twist[0, 2], twist[1, 0])


def _placed(end: End, frames: Sequence[tuple[ca.SX, ca.SX]]) -> tuple[ca.SX, ca.SX]:
    rotation, origin = (ca.SX.eye(3), ca.SX(3, 1)) if end.joint < 0 else frames[end.joint]
    place = origin + ca.mtimes(rotation, sparse(end.frame[:3, 3:]))
    return ca.mtimes(rotation, sparse(end.frame[:3, :3])), place
