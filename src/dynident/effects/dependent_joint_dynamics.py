"""Torque of a machine with passive joints: columns of its tree, projected onto the driven joints.

Γ = Gᵀ Γ_tree with G = ∂q/∂q_a. Columns are built from the signals of the tree, as for any robot, and then projected to
the driven joints. Effects on a driven joint depend on the load and motor torque of that driven joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynident.array_types import FloatArray
from dynident.effects.newton_euler import build_inverse_dynamics
from dynident.effects.rigid_body_rows import Mechanics, build_dynamic_rows, build_energy_rows, build_wrench_rows
from dynident.expressions.sines_and_cosines import AngleTerms
from dynident.robot.loop_closure import Closure
from dynident.robot.robot_model import Linkage, Robot


@dataclass(frozen=True, eq=False)
class OpenMotion:
    """Motion SX (N, 1) of all joints of the tree as expressions of driven motion SX (n, 1) and of symbols for x.

    Symbols stand for the passive positions x, so that no derivative goes through the expressions that solve for them.
    """

    linkage: Linkage
    derivatives: tuple[ca.SX, ...]

    @cached_property
    def q(self) -> ca.SX:
        """SX (N, 1)."""
        free = self.derivatives[0]
        if self.linkage.closure is not None:
            free = ca.vertcat(free, self.linkage.closure.symbols[1])
        return ca.mtimes(_to_sparse(self.linkage.ratios), free) + ca.DM(self.linkage.offsets)

    @cached_property
    def jacobian(self) -> ca.SX:
        """G SX (N, n)."""
        n, ratios = len(self.linkage.driven), _to_sparse(self.linkage.ratios)
        closure = self.linkage.closure
        if closure is None:
            return ratios
        # q depends on q_a directly, by the ratios, and through x, which keeps the loops closed.
        slopes = closure.rates(self.derivatives[0], closure.symbols[1])
        return ca.sparsify(ratios[:, :n] + ca.mtimes(ratios[:, n:], slopes))

    @cached_property
    def dq(self) -> ca.SX:
        """SX (N, 1)."""
        return ca.mtimes(self.jacobian, self.derivatives[1])

    @cached_property
    def ddq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._differentiate(1)

    @cached_property
    def dddq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._differentiate(2)

    @cached_property
    def ddddq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._differentiate(3)

    def project_torque(self, torque: ca.SX) -> ca.SX:
        """Return Gᵀ Γ_tree SX (n, k) of torques of the tree's joints SX (N, k)."""
        return ca.sparsify(ca.mtimes(self.jacobian.T, torque))

    def substitute_passive(self, expression: ca.SX) -> ca.SX:
        """Return an expression of driven motion and the symbols of x as an expression of driven motion alone."""
        closure = self.linkage.closure
        return expression if closure is None else closure.substitute_passive(expression, self.derivatives[0])

    def _differentiate(self, order: int) -> ca.SX:
        """Return the time derivative SX (N, 1) of order + 1: acceleration for 1, jerk for 2, …."""
        # q = ratios [q_a; x] + offsets with constant ratios: every derivative is the same combination.
        free = self.derivatives[order + 1]
        if self.linkage.closure is not None:
            free = ca.vertcat(free, self._differentiate_passive(self.linkage.closure, order))
        return ca.mtimes(_to_sparse(self.linkage.ratios), free)

    def _differentiate_passive(self, closure: Closure, order: int) -> ca.SX:
        driven, x = closure.symbols
        names = ("dqa", "ddqa", "dddqa", "ddddqa")
        rates = [ca.SX.sym(name, closure.n) for name in names[: order + 1]]
        state_symbols = [driven, *rates[:-1]]
        # Differentiate ẍ(q_a, x, q̇_a, q̈_a) in time by the chain rule, once for every order above the acceleration.
        value = closure.accelerations(driven, x, rates[0], rates[1])
        # ẋ, with which a change of x enters the chain rule: x has no derivative of its own among the symbols.
        moving = ca.mtimes(closure.rates(driven, x), rates[0])
        for count in range(1, order):
            state, change = ca.vertcat(*state_symbols[: count + 2], x), ca.vertcat(*rates[: count + 2], moving)
            value = ca.jtimes(value, state, change)
        derivatives = [ca.densify(derivative) for derivative in self.derivatives[: order + 2]]
        return ca.substitute([value], [driven, *rates], derivatives)[0]


@dataclass(frozen=True, eq=False)
class TreeMotion:
    """Motion of all joints of the tree as functions of the driven joints' motion.

    Parameters
    ----------
    linkage : Linkage
        The tree, and how its joints follow the driven ones.
    derivatives : tuple of SX (n, 1)
        Position of the driven joints and as many of its derivatives as are needed.
    """

    linkage: Linkage
    derivatives: tuple[ca.SX, ...]

    @cached_property
    def _open(self) -> OpenMotion:
        return OpenMotion(self.linkage, self.derivatives)

    @cached_property
    def q(self) -> ca.SX:
        """SX (N, 1)."""
        return self._open.substitute_passive(self._open.q)

    @cached_property
    def turns(self) -> AngleTerms:
        """The positions with their cosines and sines, SX (N, 1) each."""
        q = self._open.q
        return AngleTerms(self.q, self._open.substitute_passive(ca.cos(q)), self._open.substitute_passive(ca.sin(q)))

    @cached_property
    def jacobian(self) -> ca.SX:
        """G SX (N, n)."""
        return self._open.substitute_passive(self._open.jacobian)

    @cached_property
    def dq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._open.substitute_passive(self._open.dq)

    @cached_property
    def ddq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._open.substitute_passive(self._open.ddq)

    @cached_property
    def dddq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._open.substitute_passive(self._open.dddq)

    @cached_property
    def ddddq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._open.substitute_passive(self._open.ddddq)

    def project_torque(self, torque: ca.SX) -> ca.SX:
        """Return Gᵀ Γ_tree SX (n, k) of torques of the tree's joints SX (N, k)."""
        return ca.sparsify(ca.mtimes(self.jacobian.T, torque))


def build_all_positions(robot: Robot, q: ca.SX) -> ca.SX:
    """Return the positions of the driven joints, then of those that follow: `Robot.positions` as an expression.

    Parameters
    ----------
    robot : Robot
        The robot.
    q : SX (n, 1)
        Positions of the driven joints, rad or m.

    Returns
    -------
    SX (N, 1)
        rad or m.
    """
    if robot.linkage is None:
        return q
    return ca.vertcat(q, TreeMotion(robot.linkage, (q,)).q[list(robot.linkage.passive)])


def _to_sparse(matrix: FloatArray) -> ca.SX:
    # Without its zeros, so that no instruction multiplies by them.
    return ca.sparsify(ca.SX(ca.DM(matrix)))


class DependentMechanics(Mechanics):
    """The rigid-body model of a machine in the space of its driven joints: (n, 10 N) rows of the tree's links."""

    @cached_property
    def _motion(self) -> OpenMotion:
        assert self.robot.linkage is not None
        return OpenMotion(self.robot.linkage, (self.q, self.dq, self.ddq))

    @cached_property
    def rows(self) -> ca.SX:
        """SX (n, 10 N): the dynamic model's rows, Gᵀ times those of the tree."""
        motion = self._motion
        # x stays a symbol to the end. Its expression is then put in once, for all entries together.
        rows = build_dynamic_rows(self.robot.tree, motion.q, motion.dq, motion.ddq, self.gravity)
        return motion.substitute_passive(motion.project_torque(rows))

    @cached_property
    def wrenches(self) -> ca.SX:
        """SX (6, 10 N): the rows of the base's reaction wrench."""
        motion = self._motion
        return motion.substitute_passive(
            build_wrench_rows(self.robot.tree, motion.q, motion.dq, motion.ddq, self.gravity)
        )

    @cached_property
    def energies(self) -> tuple[ca.SX, ca.SX]:
        """(SX (1, 10 N), SX (1, 10 N)): kinetic and potential energy rows."""
        # Energies are scalars, which need no projection: the tree's motion in terms of the driven joints is enough.
        motion = self._motion
        kinetic, potential = build_energy_rows(self.robot.tree, motion.q, motion.dq, self.gravity)
        return motion.substitute_passive(kinetic), motion.substitute_passive(potential)


def build_link_torque(
    robot: Robot,
    q: ca.SX,
    dq: ca.SX,
    ddq: ca.SX,
    gravity: ca.SX,
    inertia: ca.SX,
    shift: ca.SX | None = None,
) -> ca.SX:
    """Return the torque of the links SX (n, 1) in the space of the driven joints.

    Parameters
    ----------
    robot : Robot
        The robot, with or without joints that follow others.
    q, dq, ddq : SX (n, 1)
        Motion of the driven joints: rad or m, and their derivatives.
    gravity : SX (3, 1)
        Acceleration of gravity in the base frame, m/s².
    inertia : SX (10 N, 1)
        Standard inertial parameters of the tree's links, in the order of `INERTIAL_NAMES`.
    shift : SX (3, N), optional
        How far the origin of every joint's frame is from where the description says, in its antecedent's frame (m).

    Returns
    -------
    SX (n, 1)
        N m or N.
    """
    if robot.linkage is None:
        return build_inverse_dynamics(robot, q, dq, ddq, gravity, inertia, shift)
    motion = OpenMotion(robot.linkage, (q, dq, ddq))
    torque = build_inverse_dynamics(robot.tree, motion.q, motion.dq, motion.ddq, gravity, inertia, shift)
    return motion.substitute_passive(motion.project_torque(torque))
