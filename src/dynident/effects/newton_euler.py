"""Inverse dynamics with given inertial parameters, by the recursion of Newton and Euler, as CasADi expressions.

The rows of the dynamic model times the parameters give the same torque; the recursion needs about half of the
instructions, also where it is differentiated (UR10: 683 and 1,218; Panda: 810 and 2,138).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from dynident.effects.rigid_body_rows import Frame, Tree, build_frames, cross_product, to_constant
from dynident.robot.joint import Joint
from dynident.robot.robot_model import Robot


@dataclass(frozen=True, eq=False)
class _Motion:
    """Angular velocity and acceleration of a link, and the acceleration of its origin less gravity; SX (3, 1)."""

    omega: ca.SX
    alpha: ca.SX
    acceleration: ca.SX


def build_inverse_dynamics(
    robot: Robot,
    q: ca.SX,
    dq: ca.SX,
    ddq: ca.SX,
    gravity: ca.SX,
    inertia: ca.SX,
    shift: ca.SX | None = None,
) -> ca.SX:
    """Return the joint torque that the links need.

    Parameters
    ----------
    robot : Robot
        A tree of joints that all move by themselves.
    q, dq, ddq : SX (n, 1)
        Motion: rad or m, and their derivatives.
    gravity : SX (3, 1)
        Acceleration of gravity in the base frame, m/s².
    inertia : SX (10 n, 1)
        Standard inertial parameters, link by link in the order of `INERTIAL_NAMES`.
    shift : SX (3, n), optional
        How far the origin of every joint's frame is from where the description says, in its antecedent's frame (m).

    Returns
    -------
    SX (n, 1)
        N m or N.
    """
    if shift is None:
        return _derive_torque(Tree.from_robot(robot))(q, dq, ddq, gravity, inertia)
    return _build_torque(robot, q, dq, ddq, gravity, inertia, shift)


@lru_cache(maxsize=32)
def _derive_torque(tree: Tree) -> ca.Function:
    """Return the torque as a function of the motion, gravity and the parameters."""
    n = tree.robot.n
    q, dq, ddq = (ca.SX.sym(name, n) for name in ("q", "dq", "ddq"))
    gravity, inertia = ca.SX.sym("g", 3), ca.SX.sym("K", 10 * n)
    torque = _build_torque(tree.robot, q, dq, ddq, gravity, inertia, None)
    return ca.Function("torque", [q, dq, ddq, gravity, inertia], [torque])


def _build_torque(
    robot: Robot, q: ca.SX, dq: ca.SX, ddq: ca.SX, gravity: ca.SX, inertia: ca.SX, shift: ca.SX | None
) -> ca.SX:
    frames = build_frames(robot, q)
    if shift is not None:
        frames = [Frame(frame.rotation, frame.origin + shift[:, i]) for i, frame in enumerate(frames)]
    # Outward: velocities and accelerations. Starting at rest with the acceleration -g stands for gravity on all links.
    motions: list[_Motion] = []
    forces: list[ca.SX] = []
    moments: list[ca.SX] = []
    rest = _Motion(ca.SX.zeros(3, 1), ca.SX.zeros(3, 1), -gravity)
    for i, (joint, frame) in enumerate(zip(robot.joints, frames, strict=True)):
        moving = _propagate_motion(rest if joint.parent < 0 else motions[joint.parent], joint, frame, dq[i], ddq[i])
        force, moment = _build_wrench(moving, inertia[10 * i : 10 * i + 10])
        motions.append(moving)
        forces.append(force)
        moments.append(moment)
    # Inward: each joint passes the wrench of its link and of all links beyond it on to the link before.
    torque = [ca.SX(1, 1) for _ in range(robot.n)]
    for i in reversed(range(robot.n)):
        joint, frame = robot.joints[i], frames[i]
        # The motor gives the part along the joint's axis; the bearings carry the rest.
        torque[i] = ca.dot(to_constant(joint.axis), moments[i] if joint.kind == "revolute" else forces[i])
        if joint.parent >= 0:
            force = ca.mtimes(frame.rotation, forces[i])
            forces[joint.parent] += force
            moments[joint.parent] += ca.mtimes(frame.rotation, moments[i]) + cross_product(frame.origin, force)
    return ca.vertcat(*torque)


def _propagate_motion(parent: _Motion, joint: Joint, frame: Frame, dq: ca.SX, ddq: ca.SX) -> _Motion:
    """Return the motion of a link, in its own frame, from that of its antecedent."""
    down, axis = frame.rotation.T, to_constant(joint.axis)
    omega = ca.mtimes(down, parent.omega)
    alpha = ca.mtimes(down, parent.alpha)
    # A point of the antecedent at `origin`: tangential and centripetal acceleration on top of that of its own origin.
    lever = cross_product(parent.alpha, frame.origin) + cross_product(
        parent.omega, cross_product(parent.omega, frame.origin)
    )
    acceleration = ca.mtimes(down, parent.acceleration + lever)
    # As in `mechanics`, α needs the antecedent's ω, before the joint's own rate is added to it.
    if joint.kind == "revolute":
        alpha = alpha + axis * ddq + cross_product(omega, axis * dq)
        return _Motion(omega + axis * dq, alpha, acceleration)
    # A sliding joint turns nothing; it adds its own acceleration and Coriolis' one.
    return _Motion(omega, alpha, acceleration + axis * ddq + 2 * cross_product(omega, axis * dq))


def _build_wrench(motion: _Motion, k: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the force and moment (3, 1) about the frame's origin that a link with parameters k (10, 1) needs."""
    inertia = ca.vertcat(ca.horzcat(k[0], k[1], k[2]), ca.horzcat(k[1], k[3], k[4]), ca.horzcat(k[2], k[4], k[5]))
    first, mass = k[6:9], k[9]
    omega, alpha, acceleration = motion.omega, motion.alpha, motion.acceleration
    # Newton and Euler about the frame's origin, which is not the centre of mass: hence the first moments in both.
    force = mass * acceleration + cross_product(alpha, first) + cross_product(omega, cross_product(omega, first))
    moment = (
        ca.mtimes(inertia, alpha) + cross_product(omega, ca.mtimes(inertia, omega)) + cross_product(first, acceleration)
    )
    return force, moment


def build_link_jacobian(robot: Robot, q: ca.SX, tip: int) -> ca.SX:
    """Return the Jacobian of a link's frame: linear, then angular velocity, in the base frame.

    Parameters
    ----------
    robot : Robot
        A tree of joints that all move by themselves.
    q : SX (n, 1)
        Positions, rad or m.
    tip : int
        Index of the joint that moves the link.

    Returns
    -------
    SX (6, n)
        m/s and rad/s for one rad/s or m/s of each joint.
    """
    frames = build_frames(robot, q)
    rotations: list[ca.SX] = []
    origins: list[ca.SX] = []
    for joint, frame in zip(robot.joints, frames, strict=True):
        root = joint.parent < 0
        rotation = ca.SX.eye(3) if root else rotations[joint.parent]
        origin = ca.SX.zeros(3, 1) if root else origins[joint.parent]
        rotations.append(ca.mtimes(rotation, frame.rotation))
        origins.append(origin + ca.mtimes(rotation, frame.origin))
    jacobian = ca.SX.zeros(6, robot.n)
    link = tip
    while link >= 0:
        joint = robot.joints[link]
        axis = ca.mtimes(rotations[link], to_constant(np.asarray(joint.axis)))
        # Only joints between base and link move it; the others' columns stay zero.
        if joint.kind == "revolute":
            jacobian[:3, link] = cross_product(axis, origins[tip] - origins[link])
            jacobian[3:, link] = axis
        else:
            jacobian[:3, link] = axis
        link = joint.parent
    return jacobian
