"""Cut joints: two frames of a tree that coincide, and how far they are apart as an expression of its positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

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


def gap_of(loop: Loop, joints: Sequence[Joint], q: ca.SX) -> ca.SX:
    """How far the two frames of a loop are apart, SX (equations, 1): m, and rad where they coincide wholly.

    Both are seen from the last joint that carries them both, whose motion closes or opens nothing. A plane that is
    fixed there is not turned with the first frame.
    """
    chains = [_carriers(joints, end.joint) for end in loop.ends]
    shared = len([a for a, b in zip(*chains, strict=False) if a == b])
    (turned, first), (other, second) = (
        _frame_of(joints, chain[shared:], end.frame, q) for chain, end in zip(chains, loop.ends, strict=True)
    )
    apart = second - first
    if loop.kind == "planar":
        plane = ca.SX(ca.DM(_across(turned[:, 2]))) if turned[:, 2].is_constant() else turned[:, :2].T
        whole = ca.mtimes(ca.sparsify(plane), apart)
    elif loop.kind == "point":
        whole = apart
    else:
        between = ca.mtimes(turned.T, other)
        twist = 0.5 * (between - between.T)
        whole = ca.vertcat(apart, twist[2, 1], twist[0, 2], twist[1, 0])
    return whole if loop.equations is None else whole[list(loop.equations)]


def _across(normal: ca.SX) -> FloatArray:
    """Two unit vectors (2, 3) across a constant one."""
    axis = np.asarray(ca.DM(normal)).ravel()
    first = np.cross(np.eye(3)[int(np.argmin(np.abs(axis)))], axis)
    first /= np.linalg.norm(first)
    return np.array([np.cross(axis, first), first])


def _carriers(joints: Sequence[Joint], joint: int) -> list[int]:
    """Joints that move a frame, the base's first."""
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = joints[joint].parent
    return chain[::-1]


def _frame_of(joints: Sequence[Joint], chain: Sequence[int], frame: FloatArray, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rotation (3, 3) and origin (3, 1) of a frame at the end of a chain of joints, from where the chain starts."""
    rotation, origin = ca.SX.eye(3), ca.SX(3, 1)
    for index in chain:
        joint = joints[index]
        origin = origin + ca.mtimes(rotation, sparse(joint.placement[:3, 3:]))
        rotation = ca.mtimes(rotation, sparse(joint.placement[:3, :3]))
        axis = sparse(joint.axis[:, None])
        if joint.kind == "prismatic":
            origin = origin + ca.mtimes(rotation, axis) * q[index]
        else:
            along = ca.mtimes(axis, axis.T)
            turn = ca.cos(q[index]) * (ca.SX.eye(3) - along) + ca.sin(q[index]) * ca.skew(ca.densify(axis)) + along
            rotation = ca.mtimes(rotation, ca.sparsify(turn))
    place = origin + ca.mtimes(rotation, sparse(frame[:3, 3:]))
    return ca.mtimes(rotation, sparse(frame[:3, :3])), place
