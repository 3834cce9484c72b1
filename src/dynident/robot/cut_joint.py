"""A cut joint of a closed loop: two frames that must coincide, the gap between them, and errors about loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

import dynident.expressions  # noqa: F401 - threads may use CasADi
from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.robot.joint import Joint

LOOP_TITLE = "Unusable closed loop"


def make_loop_error(detail: str, loop: Loop) -> DynidentError:
    """Return an error that names a loop's place.

    Parameters
    ----------
    detail : str
        What is wrong, and what to do about it.
    loop : Loop
        The loop, with its place in the description.

    Returns
    -------
    DynidentError
        To be raised.
    """
    return DynidentError(f"line {loop.line}: {detail}" if loop.line else detail, pointer=loop.where, title=LOOP_TITLE)


def make_redundancy_error(loop: Loop, equations: int, unknowns: int, passive: str) -> DynidentError:
    """Return the error of a loop with more equations than passive joints.

    Parameters
    ----------
    loop : Loop
        The loop, with its place in the description.
    equations, unknowns : int
        Number of its equations and of its passive joints.
    passive : str
        Names of these joints.

    Returns
    -------
    DynidentError
        To be raised.
    """
    return make_loop_error(
        f"Loop '{loop.name}' has redundant constraints: {equations} equations for {unknowns} passive joints "
        f"({passive}). Use the kind planar (2 equations) for a loop in a plane, and point (3 equations) for a loop "
        "with ball joints.",
        loop,
    )


def make_reach_error(loop: Loop, reached: int, sampled: int) -> DynidentError:
    """Return the error of loops that meet singular postures almost wherever their driven joints go.

    Parameters
    ----------
    loop : Loop
        One of the loops, with its place in the description.
    reached, sampled : int
        Number of postures that were reached, and of those that were tried.

    Returns
    -------
    DynidentError
        To be raised.
    """
    return make_loop_error(
        "The loops can hardly move within the limits of the driven joints without passing a singular posture: only "
        f"{reached} of {sampled} sampled postures can be reached. Set limits of the driven joints, or another start.",
        loop,
    )


def make_approximation_error(loop: Loop) -> DynidentError:
    """Return the error of loops whose passive positions no polynomial approximates well enough."""
    return make_loop_error(
        "Within the limits of the driven joints the loops come too near singular postures, so the passive positions "
        "cannot be computed everywhere. Set narrower limits of the driven joints.",
        loop,
    )


LoopKind = Literal["planar", "point", "full"]
EQUATIONS = {"planar": 2, "point": 3, "full": 6}
"""Number of equations of a loop of each kind."""


@dataclass(frozen=True, eq=False)
class FrameOnJoint:
    """One side of a cut joint.

    Parameters
    ----------
    joint : int
        Index of the joint of the tree that carries it; -1 for the base.
    frame : (4, 4)
        Placement in that joint's frame, m.
    """

    joint: int
    frame: FloatArray


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed loop: two frames that coincide wherever the machine moves.

    Parameters
    ----------
    name : str
        Name of the loop, for messages.
    kind : {"planar", "point", "full"}
        Which part of the frames coincides: the origins in the xy plane of the first frame (a pin), the origins (a ball
        joint), or the whole frames.
    ends : tuple of two FrameOnJoint
        The frames, each on a joint of the tree.
    where, line : str, int
        Place in the description, for messages: a JSON pointer and the number of a line, 0 where there is none.
    equations : tuple of int, optional
        Those of its kind's equations that count; all of them by default.
    """

    name: str
    kind: LoopKind
    ends: tuple[FrameOnJoint, FrameOnJoint]
    where: str = ""
    line: int = 0
    equations: tuple[int, ...] | None = None

    @property
    def count(self) -> int:
        """Number of its equations."""
        return EQUATIONS[self.kind] if self.equations is None else len(self.equations)


def to_sparse_constant(matrix: FloatArray) -> ca.SX:
    """Return a matrix as constants without its zeros, so that no instruction multiplies by them."""
    return ca.sparsify(ca.SX(ca.DM(matrix)))


def build_gap(loop: Loop, joints: Sequence[Joint], q: ca.SX) -> ca.SX:
    """Return the gap between the two frames of a loop as an expression of the tree's positions.

    Parameters
    ----------
    loop : Loop
        The loop.
    joints : sequence of Joint
        All joints of the tree.
    q : SX (N, 1)
        Their positions, rad or m.

    Returns
    -------
    SX (equations, 1)
        In m, and in rad for the rotation of whole frames.
    """
    # Look at both frames from the last joint that carries both: the joints before it move the two ends alike, so they
    # neither open nor close the loop and would only lengthen the expressions.
    chains = [_list_carriers(joints, end.joint) for end in loop.ends]
    shared = len([a for a, b in zip(*chains, strict=False) if a == b])
    (turned, first), (other, second) = (
        _build_frame(joints, chain[shared:], end.frame, q) for chain, end in zip(chains, loop.ends, strict=True)
    )
    distance = second - first
    if loop.kind == "planar":
        # Where the normal is constant, two fixed directions across it span the plane as well as the turning frame does.
        plane = ca.SX(ca.DM(_get_plane_directions(turned[:, 2]))) if turned[:, 2].is_constant() else turned[:, :2].T
        whole = ca.mtimes(ca.sparsify(plane), distance)
    elif loop.kind == "point":
        whole = distance
    else:
        # The antisymmetric part of the relative rotation vanishes with the rotation, and near zero it is its vector.
        between = ca.mtimes(turned.T, other)
        twist = 0.5 * (between - between.T)
        whole = ca.vertcat(distance, twist[2, 1], twist[0, 2], twist[1, 0])
    return whole if loop.equations is None else whole[list(loop.equations)]


def _get_plane_directions(normal: ca.SX) -> FloatArray:
    """Return two unit vectors (2, 3) at right angles to a constant one and to each other."""
    axis = np.asarray(ca.DM(normal)).ravel()
    first = np.cross(np.eye(3)[int(np.argmin(np.abs(axis)))], axis)
    first /= np.linalg.norm(first)
    return np.array([np.cross(axis, first), first])


def _list_carriers(joints: Sequence[Joint], joint: int) -> list[int]:
    """Return the joints that move a frame, from the base outward."""
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = joints[joint].parent
    return chain[::-1]


def _build_frame(joints: Sequence[Joint], chain: Sequence[int], frame: FloatArray, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return rotation (3, 3) and origin (3, 1) of a frame at the end of a chain of joints, seen from its start."""
    rotation, origin = ca.SX.eye(3), ca.SX(3, 1)
    for index in chain:
        joint = joints[index]
        origin = origin + ca.mtimes(rotation, to_sparse_constant(joint.placement[:3, 3:]))
        rotation = ca.mtimes(rotation, to_sparse_constant(joint.placement[:3, :3]))
        axis = to_sparse_constant(joint.axis[:, None])
        if joint.kind == "prismatic":
            origin = origin + ca.mtimes(rotation, axis) * q[index]
        else:
            along = ca.mtimes(axis, axis.T)
            turn = ca.cos(q[index]) * (ca.SX.eye(3) - along) + ca.sin(q[index]) * ca.skew(ca.densify(axis)) + along
            rotation = ca.mtimes(rotation, ca.sparsify(turn))
    place = origin + ca.mtimes(rotation, to_sparse_constant(frame[:3, 3:]))
    return ca.mtimes(rotation, to_sparse_constant(frame[:3, :3])), place
