"""Rows of rigid-body mechanics as CasADi expressions: dynamic model, energy and base wrench [12.18], [12.33].

There are two independent derivations: the rows of the dynamic model [12.18] by a velocity recursion (short, used in the
hot path), and the rows of the kinetic and potential energy [12.33]-[12.34] (the single source of the filtered, energy
and power models). Tests compare one with the other and both with Pinocchio.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

import dynident.expressions  # noqa: F401 - threads may use CasADi
from dynident.array_types import FloatArray
from dynident.robot.joint import Joint
from dynident.robot.robot_model import Robot

# Rounded right angles in a description leave 1e-17 where zero is meant, and each such entry costs instructions.
_SNAP = 1e-12
# What right angles, and angles of sixty degrees, leave in rotations and axes.
_LANDMARKS = (0.0, 1.0, -1.0, 0.5, -0.5)


def _snap(matrix: FloatArray) -> FloatArray:
    snapped = matrix.copy()
    for landmark in _LANDMARKS:
        snapped[np.abs(matrix - landmark) < _SNAP] = landmark
    return snapped


def _to_sparse(matrix: FloatArray) -> ca.SX:
    return ca.sparsify(ca.SX(ca.DM(_snap(matrix))))


def to_constant(vector: FloatArray) -> ca.SX:
    """Return a vector (3,) of a description as constants SX (3, 1), with rounded zeros set to zero."""
    return ca.SX(ca.DM(_snap(vector)))


def cross_product(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return the vector product of two vectors.

    Parameters
    ----------
    a, b : SX (3, 1)
        The vectors.

    Returns
    -------
    SX (3, 1)
        a × b.
    """
    return ca.vertcat(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _build_rotation(joint: Joint, q: ca.SX) -> ca.SX:
    """Return the rotation from the joint's frame to the frame of its placement."""
    if joint.kind == "prismatic":
        return ca.SX.eye(3)
    x, y, z = (float(value) for value in _snap(joint.axis))
    axis = ca.SX(ca.DM([x, y, z]))
    # Rodrigues' formula: cos q (1 - a aᵀ) + sin q [a]x + a aᵀ.
    along = ca.mtimes(axis, axis.T)
    return ca.cos(q) * (ca.SX.eye(3) - along) + ca.sin(q) * ca.skew(axis) + along


@dataclass(frozen=True)
class Tree:
    """A tree of joints: robots with the same joints are equal trees, whatever else is known of them.

    Expressions are derived once for equal trees: CasADi copies them into others a hundred times faster.

    Parameters
    ----------
    joints : tuple
        Kind, antecedent, axis and placement of each joint.
    robot : Robot
        One robot of that tree.
    """

    joints: tuple[tuple[str, int, bytes, bytes], ...]
    robot: Robot = field(compare=False)

    @classmethod
    def from_robot(cls, robot: Robot) -> Tree:
        """Return the tree of a robot."""
        joints = (
            (joint.kind, joint.parent, np.asarray(joint.axis, float).tobytes(), joint.placement.tobytes())
            for joint in robot.joints
        )
        return cls(tuple(joints), robot)


@dataclass(frozen=True, eq=False)
class Frame:
    """Placement of a joint's frame in its antecedent's frame.

    Parameters
    ----------
    rotation : SX (3, 3)
        Orientation.
    origin : SX (3, 1)
        Origin, m.
    """

    rotation: ca.SX
    origin: ca.SX


def build_frames(robot: Robot, q: ca.SX) -> list[Frame]:
    """Return the frame of every joint in its antecedent's frame.

    Parameters
    ----------
    robot : Robot
        A tree of joints that all move by themselves.
    q : SX (n, 1)
        Positions, rad or m.

    Returns
    -------
    list of Frame
        In the order of the joints.
    """
    frames = []
    for index, joint in enumerate(robot.joints):
        fixed = _to_sparse(joint.placement[:3, :3])
        origin = ca.densify(_to_sparse(joint.placement[:3, 3:]))
        if joint.kind == "prismatic":
            origin = origin + ca.mtimes(fixed, to_constant(joint.axis)) * q[index]
        frames.append(Frame(ca.mtimes(fixed, _build_rotation(joint, q[index])), origin))
    return frames


def _build_body_regressor(omega: ca.SX, alpha: ca.SX, acceleration: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return force (3, 10) and moment (3, 10) about the frame's origin, linear in XX … M of one link."""
    w, a = omega, alpha
    zero = ca.SX(1, 1)
    # n = J α + ω x (J ω), column by column of XX XY XZ YY YZ ZZ
    inertia = ca.horzcat(
        ca.vertcat(a[0], w[2] * w[0], -w[1] * w[0]),
        ca.vertcat(a[1] - w[2] * w[0], a[0] + w[2] * w[1], w[0] * w[0] - w[1] * w[1]),
        ca.vertcat(a[2] + w[1] * w[0], w[2] * w[2] - w[0] * w[0], a[0] - w[1] * w[2]),
        ca.vertcat(-w[2] * w[1], a[1], w[0] * w[1]),
        ca.vertcat(w[1] * w[1] - w[2] * w[2], a[2] - w[0] * w[1], a[1] + w[0] * w[2]),
        ca.vertcat(w[1] * w[2], -w[0] * w[2], a[2]),
    )
    # f = M a + ([α]x + [ω]x²) MS, and the first moments' part of the moment is MS x a = -[a]x MS.
    wx = ca.skew(w)
    spin = ca.skew(a) + ca.mtimes(wx, wx)
    force = ca.horzcat(ca.SX(3, 6), spin, acceleration)
    moment = ca.horzcat(inertia, -ca.skew(acceleration), ca.vertcat(zero, zero, zero))
    return force, moment


def build_dynamic_rows(robot: Robot, q: ca.SX, dq: ca.SX, ddq: ca.SX, gravity: ca.SX) -> ca.SX:
    """Return the observation rows of the dynamic model [12.18] for the standard inertial parameters.

    Parameters
    ----------
    robot : Robot
        A tree of joints that all move by themselves.
    q, dq, ddq : SX (n, 1)
        Motion: rad or m, and their derivatives.
    gravity : SX (3, 1)
        Acceleration of gravity in the base frame, m/s².

    Returns
    -------
    SX (n, 10 n)
        Structurally zero where the torque of a joint cannot depend on a link. Columns are link by link in the order of
        `INERTIAL_NAMES`.
    """
    return ca.sparsify(_derive_rows(Tree.from_robot(robot), of_base=False)(q, dq, ddq, gravity))


def build_wrench_rows(robot: Robot, q: ca.SX, dq: ca.SX, ddq: ca.SX, gravity: ca.SX) -> ca.SX:
    """Return the observation rows of the base's reaction wrench for the standard inertial parameters (§12.8).

    Friction, motor torques and rotors do not appear: they are internal to the robot.

    Parameters
    ----------
    robot : Robot
        A tree of joints that all move by themselves.
    q, dq, ddq : SX (n, 1)
        Motion: rad or m, and their derivatives.
    gravity : SX (3, 1)
        Acceleration of gravity in the base frame, m/s².

    Returns
    -------
    SX (6, 10 n)
        Force on the robot, then moment about the origin of the base frame, both along its axes. At rest the force
        carries the weight.
    """
    return ca.sparsify(_derive_rows(Tree.from_robot(robot), of_base=True)(q, dq, ddq, gravity))


@lru_cache(maxsize=32)
def _derive_rows(tree: Tree, *, of_base: bool) -> ca.Function:
    """Return the rows as a function of the motion and gravity."""
    q, dq, ddq = (ca.SX.sym(name, tree.robot.n) for name in ("q", "dq", "ddq"))
    gravity = ca.SX.sym("g", 3)
    rows = _build_projected_rows(tree.robot, q, dq, ddq, gravity, of_base=of_base)
    return ca.Function("rows", [q, dq, ddq, gravity], [rows])


def _build_projected_rows(robot: Robot, q: ca.SX, dq: ca.SX, ddq: ca.SX, gravity: ca.SX, *, of_base: bool) -> ca.SX:
    """Return each link's wrench projected on the unit twists of the joints that carry it, or on the base's six."""
    n = robot.n
    zero = ca.SX.zeros(3, 1)
    base: dict[int, tuple[ca.SX, ca.SX]] = {}
    if of_base:
        # Three translations, then three rotations: a wrench's products with these twists are its force and its moment.
        axes = [ca.SX(ca.DM.eye(3)[:, k]) for k in range(3)]
        base = {k: (zero, axes[k]) for k in range(3)} | {3 + k: (axes[k], zero) for k in range(3)}
    omegas: list[ca.SX] = []
    alphas: list[ca.SX] = []
    accelerations: list[ca.SX] = []
    twists: list[dict[int, tuple[ca.SX, ca.SX]]] = []  # row j -> its unit twist (angular, linear) at this frame
    # Structural zeros to begin with: a joint does not feel the links that it does not move.
    rows = [[ca.SX(1, 10) for _ in range(n)] for _ in range(6 if of_base else n)]
    for i, (joint, frame) in enumerate(zip(robot.joints, build_frames(robot, q), strict=True)):
        root = joint.parent < 0
        down = frame.rotation.T
        omega_p = zero if root else omegas[joint.parent]
        alpha_p = zero if root else alphas[joint.parent]
        # A base that is accelerated by -g, without gravity, needs the same torques as one at rest in gravity.
        acceleration_p = -gravity if root else accelerations[joint.parent]
        axis = to_constant(joint.axis)
        omega = ca.mtimes(down, omega_p)
        alpha = ca.mtimes(down, alpha_p)
        lever = cross_product(alpha_p, frame.origin) + cross_product(omega_p, cross_product(omega_p, frame.origin))
        acceleration = ca.mtimes(down, acceleration_p + lever)
        # The order matters: α needs the antecedent's ω, before the joint's own rate is added to it.
        if joint.kind == "revolute":
            alpha = alpha + axis * ddq[i] + cross_product(omega, axis * dq[i])
            omega = omega + axis * dq[i]
        else:
            # The sliding joint's own acceleration and Coriolis' one.
            acceleration = acceleration + axis * ddq[i] + 2 * cross_product(omega, axis * dq[i])
        # A joint feels the wrenches of all links that it moves: carry its unit twist along to every later link's frame,
        # where its product with the link's wrench is the torque by virtual power.
        inherited = base if root else twists[joint.parent]
        here = {
            j: (ca.mtimes(down, angular), ca.mtimes(down, linear + cross_product(angular, frame.origin)))
            for j, (angular, linear) in inherited.items()
        }
        if not of_base:
            here[i] = (axis, zero) if joint.kind == "revolute" else (zero, axis)
        omegas.append(omega)
        alphas.append(alpha)
        accelerations.append(acceleration)
        twists.append(here)
        force, moment = _build_body_regressor(omega, alpha, acceleration)
        for j, (angular, linear) in here.items():
            rows[j][i] = ca.mtimes(linear.T, force) + ca.mtimes(angular.T, moment)
    return ca.sparsify(ca.vertcat(*(ca.horzcat(*row) for row in rows)))


def build_energy_rows(robot: Robot, q: ca.SX, dq: ca.SX, gravity: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the rows e(q, q̇) and u(q) of [12.32]-[12.34] for the standard inertial parameters.

    Parameters
    ----------
    robot : Robot
        A tree of joints that all move by themselves.
    q, dq : SX (n, 1)
        Positions and velocities: rad or m, rad/s or m/s.
    gravity : SX (3, 1)
        Acceleration of gravity in the base frame, m/s².

    Returns
    -------
    kinetic : SX (1, 10 n)
        Kinetic energy E = e K, J.
    potential : SX (1, 10 n)
        Potential energy U = u K, J.
    """
    kinetic, potential = [], []
    omegas: list[ca.SX] = []
    velocities: list[ca.SX] = []
    poses: list[tuple[ca.SX, ca.SX]] = []
    zero = ca.SX.zeros(3, 1)
    for i, (joint, frame) in enumerate(zip(robot.joints, build_frames(robot, q), strict=True)):
        root = joint.parent < 0
        omega_p, velocity_p = (zero, zero) if root else (omegas[joint.parent], velocities[joint.parent])
        rotation_p, origin_p = (ca.SX.eye(3), zero) if root else poses[joint.parent]
        down = frame.rotation.T
        axis = to_constant(joint.axis)
        w = ca.mtimes(down, omega_p)
        v = ca.mtimes(down, velocity_p + cross_product(omega_p, frame.origin))
        if joint.kind == "revolute":
            w = w + axis * dq[i]
        else:
            v = v + axis * dq[i]
        rotation = ca.mtimes(rotation_p, frame.rotation)
        origin = origin_p + ca.mtimes(rotation_p, frame.origin)
        omegas.append(w)
        velocities.append(v)
        poses.append((rotation, origin))
        # ½ ωᵀ J ω + MSᵀ (v x ω) + ½ M vᵀ v, in the order of `INERTIAL_NAMES`.
        kinetic.append(
            ca.horzcat(
                0.5 * w[0] * w[0], w[0] * w[1], w[0] * w[2], 0.5 * w[1] * w[1], w[1] * w[2], 0.5 * w[2] * w[2],
                w[2] * v[1] - w[1] * v[2], w[0] * v[2] - w[2] * v[0], w[1] * v[0] - w[0] * v[1],
                0.5 * ca.dot(v, v),
            )
        )  # fmt: skip
        # U = -gᵀ (M p + R MS): moments of inertia have no part in it.
        down_gravity = -ca.mtimes(gravity.T, rotation)
        potential.append(ca.horzcat(ca.SX(1, 6), down_gravity, -ca.dot(gravity, origin)))
    return ca.sparsify(ca.horzcat(*kinetic)), ca.sparsify(ca.horzcat(*potential))


@dataclass(frozen=True, eq=False)
class Mechanics:
    """The symbolic rigid-body model of one robot; each part is built once, when first asked for.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, dq, ddq : SX (n, 1)
        Symbols of the motion: rad or m, and their derivatives.
    """

    robot: Robot
    q: ca.SX
    dq: ca.SX
    ddq: ca.SX

    @cached_property
    def gravity(self) -> ca.SX:
        """The robot's gravity (3, 1) as constants."""
        return to_constant(self.robot.gravity)

    @cached_property
    def rows(self) -> ca.SX:
        """SX (n, 10 n): the dynamic model's rows, [12.18]."""
        return build_dynamic_rows(self.robot, self.q, self.dq, self.ddq, self.gravity)

    @cached_property
    def wrenches(self) -> ca.SX:
        """SX (6, 10 n): the rows of the base's reaction wrench."""
        return build_wrench_rows(self.robot, self.q, self.dq, self.ddq, self.gravity)

    @cached_property
    def energies(self) -> tuple[ca.SX, ca.SX]:
        """(SX (1, 10 n), SX (1, 10 n)): kinetic and potential energy rows, [12.33] and [12.34]."""
        return build_energy_rows(self.robot, self.q, self.dq, self.gravity)
