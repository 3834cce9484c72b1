"""Forward kinematics in numpy for many postures: frames of joints, path of the tool, torques of a wrench on a link."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dynident.array_types import FloatArray
from dynident.robot.joint import Joint
from dynident.robot.robot_model import Robot

# Step of the numerical derivative in rad or m.
_MOVE = 1e-6
# Directions that a force at the tool is tried in; Jacobian (m/rad) below which it moves no joint; share of the largest
# below which none is felt in a direction.
_DIRECTIONS, _SMALL, _FLAT = 60, 1e-6, 1e-3


def joint_frames(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the frames of all joints in the base frame.

    A frame moves with its joint, so the link's inertial parameters are constant in it.

    Parameters
    ----------
    robot : Robot
        The robot.
    q : ndarray (m, n)
        Positions of the driven joints, rad or m.

    Returns
    -------
    ndarray (m, N, 4, 4)
        One homogeneous transform a joint of the tree; N > n where joints follow others.
    """
    q = np.asarray(q, dtype=float)
    if robot.linkage is not None:
        q, robot = robot.linkage.compute_positions(q), robot.tree
    frames = np.zeros((len(q), robot.n, 4, 4))
    frames[:, :, 3, 3] = 1.0
    sines, versines = np.sin(q)[:, :, None, None], (1.0 - np.cos(q))[:, :, None, None]
    # One pass is enough, since every antecedent comes before its successors.
    for index, joint in enumerate(robot.joints):
        rotation, origin, once, twice = _get_constants(joint)
        if joint.kind == "prismatic":
            origin = origin + q[:, index, None, None] * once
        else:
            # Rodrigues' formula for a rotation about the axis, as in `joint_motion`, behind the placement.
            rotation = rotation + sines[:, index] * once + versines[:, index] * twice
        if joint.parent >= 0:
            before = frames[:, joint.parent, :3, :3]
            rotation, origin = before @ rotation, before @ origin + frames[:, joint.parent, :3, 3:]
        frames[:, index, :3, :3], frames[:, index, :3, 3:] = rotation, origin
    return frames


@lru_cache(1024)
def _get_constants(joint: Joint) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what does not depend on the posture: rotation and origin of the placement, and how they follow q."""
    rotation, origin = joint.placement[:3, :3], joint.placement[:3, 3:]
    if joint.kind == "prismatic":
        slide = rotation @ joint.axis[:, None]
        return rotation, origin, slide, slide
    cross = _cross_matrix(joint.axis)
    once = rotation @ cross
    return rotation, origin, once, once @ cross


def _cross_matrix(axis: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) that gives the vector product of an axis with a vector."""
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def joint_motion(joint: Joint, q: FloatArray) -> FloatArray:
    """Return the transforms that positions add behind a joint's placement.

    Parameters
    ----------
    joint : Joint
        A joint, with its axis.
    q : ndarray (m,)
        Its positions, rad or m.

    Returns
    -------
    ndarray (m, 4, 4)
        Homogeneous transforms, m.
    """
    motion = np.zeros((len(q), 4, 4))
    motion[:, range(4), range(4)] = 1.0
    if joint.kind == "prismatic":
        motion[:, :3, 3] = q[:, None] * joint.axis
        return motion
    cross = _cross_matrix(joint.axis)
    # Rodrigues' formula for a rotation about the axis: I + sin q [a]x + (1 - cos q) [a]x².
    motion[:, :3, :3] += np.sin(q)[:, None, None] * cross + (1.0 - np.cos(q))[:, None, None] * (cross @ cross)
    return motion


def tool_path(robot: Robot, q: FloatArray, joint: int = -1, point: FloatArray | None = None) -> FloatArray:
    """Return the path of a point of the robot in the base frame.

    Parameters
    ----------
    robot : Robot
        The robot.
    q : ndarray (m, n)
        Positions of the driven joints, rad or m.
    joint : int
        Index of the joint (in the tree) that carries the point; the last one by default.
    point : ndarray (3,), optional
        The point in that joint's frame (m); the frame's origin by default.

    Returns
    -------
    ndarray (m, 3)
        In m.
    """
    frame = joint_frames(robot, q)[:, joint]
    path: FloatArray = frame[:, :3, 3] if point is None else frame[:, :3, :3] @ point + frame[:, :3, 3]
    return path


def compute_tool_jacobian(robot: Robot, q: FloatArray) -> FloatArray:
    """Compute the Jacobian of the last joint's origin by central differences.

    Parameters
    ----------
    robot : Robot
        The robot.
    q : (m, n)
        Postures in rad or m.

    Returns
    -------
    (m, 3, n)
        Change of the origin's position (m) by joint (rad or m), in the base frame.
    """
    columns = []
    for joint in range(robot.n):
        step = np.zeros(robot.n)
        step[joint] = _MOVE
        columns.append((tool_path(robot, q + step) - tool_path(robot, q - step)) / (2 * _MOVE))
    return np.stack(columns, axis=2)


def draw_unit_forces(jacobian: FloatArray) -> FloatArray | None:
    """Return directions of forces at the tool that some posture feels.

    Parameters
    ----------
    jacobian : (m, 3, n)
        Jacobians of the tool, as of `compute_tool_jacobian`.

    Returns
    -------
    (m, d, 3) or None
        Unit vectors; None where no joint feels any force.
    """
    left_vectors, singular, _ = np.linalg.svd(jacobian, full_matrices=False)
    largest = float(singular.max(initial=0.0))
    if largest <= _SMALL:
        return None
    # A planar arm feels forces in its plane alone. Directions are drawn in the space that some posture feels at all, or
    # a share of them would never show.
    rank = int((singular.max(axis=0) > _FLAT * largest).sum())
    directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, rank))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return np.asarray(np.einsum("mir,dr->mdi", left_vectors[:, :, :rank], directions))


def project_wrench(robot: Robot, q: FloatArray, link: int, wrench: FloatArray, *, in_world: bool = False) -> FloatArray:
    """Return the torques Jᵀw that a wrench on a link exerts on the driven joints.

    Parameters
    ----------
    robot : Robot
        The robot.
    q : ndarray (m, n)
        Positions of the driven joints, rad or m.
    link : int
        Index of the joint (in the tree) that carries the link.
    wrench : ndarray (m, 6)
        Force (N) on the link, then moment (N m): along the axes of the link's frame about its origin, or of the base
        frame (the world, if the base moves).
    in_world : bool
        Whether the latter.

    Returns
    -------
    ndarray (m, n)
        N m or N.
    """
    frames = joint_frames(robot, q)
    force, moment = wrench[:, :3], wrench[:, 3:]
    origin = np.zeros_like(force)
    if not in_world:
        turn, origin = frames[:, link, :3, :3], frames[:, link, :3, 3]
        force, moment = (np.einsum("mij,mj->mi", turn, part) for part in (force, moment))
    torque = np.zeros((len(q), robot.tree.n))
    for index in robot.tree.list_ancestors(link):
        joint = robot.tree.joints[index]
        axis = frames[:, index, :3, :3] @ joint.axis
        # The moment about the joint's own axis: that about the origin, carried there.
        about = moment + np.cross(origin - frames[:, index, :3, 3], force)
        torque[:, index] = np.einsum("mi,mi->m", axis, about if joint.kind == "revolute" else force)
    if robot.linkage is None:
        return torque
    return np.asarray(np.einsum("mji,mj->mi", robot.linkage.compute_jacobian(q), torque))
