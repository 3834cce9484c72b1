"""Machines whose joints are not all free: from the driven joints' signals to those of the tree, and its torque back.

Γ = Gᵀ Γ_tree with G = ∂q/∂q_a. Columns are made of the tree's own signals, as for any robot, and seen from the driven
joints; what an effect on a driven joint is a function of, load and motor torque, is that of the driven joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynident.arrays import FloatArray
from dynident.effects.mechanics import Mechanics, dynamic_rows, energy_rows, wrench_rows
from dynident.effects.newton_euler import inverse_dynamics
from dynident.robot.linkage import Linkage
from dynident.robot.model import Robot


@dataclass(frozen=True, eq=False)
class TreeMotion:
    """Motion of all joints of the tree as functions of the driven joints' q, dq, ddq, …: SX (n, 1) each."""

    linkage: Linkage
    derivatives: tuple[ca.SX, ...]

    @cached_property
    def q(self) -> ca.SX:
        """SX (N, 1)."""
        return positions_of(self.linkage, self.derivatives[0])

    @cached_property
    def jacobian(self) -> ca.SX:
        """G SX (N, n)."""
        return rates_of(self.linkage, self.derivatives[0], self.q)

    @cached_property
    def dq(self) -> ca.SX:
        """SX (N, 1)."""
        return ca.mtimes(self.jacobian, self.derivatives[1])

    @cached_property
    def ddq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._rate(self.dq, 2)

    @cached_property
    def dddq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._rate(self.ddq, 3)

    @cached_property
    def ddddq(self) -> ca.SX:
        """SX (N, 1)."""
        return self._rate(self.dddq, 4)

    def lowered(self, torque: ca.SX) -> ca.SX:
        """Gᵀ Γ_tree SX (n, k) of torques of the tree's joints SX (N, k)."""
        return ca.sparsify(ca.mtimes(self.jacobian.T, torque))

    def _rate(self, expression: ca.SX, order: int) -> ca.SX:
        known = self.derivatives
        return ca.jtimes(expression, ca.vertcat(*known[:order]), ca.vertcat(*known[1 : order + 1]))


def positions_of(linkage: Linkage, q: ca.SX) -> ca.SX:
    """Positions SX (N, 1) of all joints from those of the driven ones SX (n, 1)."""
    return ca.mtimes(_sparse(linkage.ratios), q) + ca.DM(linkage.offsets)


def rates_of(linkage: Linkage, q: ca.SX, of_tree: ca.SX) -> ca.SX:
    """G SX (N, n) at driven positions q SX (n, 1) and those of all joints SX (N, 1)."""
    return _sparse(linkage.ratios)


def all_positions(robot: Robot, q: ca.SX) -> ca.SX:
    """Positions SX of the driven joints, and behind them of those that follow: `Robot.positions` as an expression."""
    if robot.linkage is None:
        return q
    return ca.vertcat(q, positions_of(robot.linkage, q)[list(robot.linkage.passive)])


def _sparse(matrix: FloatArray) -> ca.SX:
    return ca.sparsify(ca.SX(ca.DM(matrix)))


class LinkedMechanics(Mechanics):
    """The rigid-body model of a machine in the space of its driven joints: (n, 10 N) rows of the tree's links."""

    @cached_property
    def _motion(self) -> TreeMotion:
        assert self.robot.linkage is not None
        return TreeMotion(self.robot.linkage, (self.q, self.dq, self.ddq))

    @cached_property
    def rows(self) -> ca.SX:
        """SX (n, 10 N): the dynamic model's rows, Gᵀ times those of the tree."""
        motion = self._motion
        return motion.lowered(dynamic_rows(self.robot.tree, motion.q, motion.dq, motion.ddq, self.gravity))

    @cached_property
    def wrenches(self) -> ca.SX:
        """SX (6, 10 N): the rows of the base's reaction wrench."""
        motion = self._motion
        return wrench_rows(self.robot.tree, motion.q, motion.dq, motion.ddq, self.gravity)

    @cached_property
    def energies(self) -> tuple[ca.SX, ca.SX]:
        """(SX (1, 10 N), SX (1, 10 N)): kinetic and potential energy rows."""
        return energy_rows(self.robot.tree, self._motion.q, self._motion.dq, self.gravity)


def torque_of_links(
    robot: Robot,
    q: ca.SX,
    dq: ca.SX,
    ddq: ca.SX,
    gravity: ca.SX,
    inertia: ca.SX,
    shift: ca.SX | None = None,
) -> ca.SX:
    """`inverse_dynamics` in the space of the driven joints: inertia SX (10 N, 1), shift SX (3, N)."""
    if robot.linkage is None:
        return inverse_dynamics(robot, q, dq, ddq, gravity, inertia, shift)
    motion = TreeMotion(robot.linkage, (q, dq, ddq))
    return motion.lowered(inverse_dynamics(robot.tree, motion.q, motion.dq, motion.ddq, gravity, inertia, shift))
