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
from dynident.robot.loops import Closure
from dynident.robot.model import Robot


@dataclass(frozen=True, eq=False)
class TreeMotion:
    """Motion of all joints of the tree as functions of the driven joints' q, dq, ddq, …: SX (n, 1) each."""

    linkage: Linkage
    derivatives: tuple[ca.SX, ...]

    @cached_property
    def q(self) -> ca.SX:
        """SX (N, 1)."""
        return ca.mtimes(_sparse(self.linkage.ratios), self._free[0]) + ca.DM(self.linkage.offsets)

    @cached_property
    def jacobian(self) -> ca.SX:
        """G SX (N, n)."""
        n, ratios = len(self.linkage.driven), _sparse(self.linkage.ratios)
        if self.linkage.closure is None:
            return ratios
        slopes = self.linkage.closure.rates(self.derivatives[0], self._free[0][n:])
        return ca.sparsify(ratios[:, :n] + ca.mtimes(ratios[:, n:], slopes))

    @cached_property
    def dq(self) -> ca.SX:
        """SX (N, 1)."""
        return ca.mtimes(self.jacobian, self.derivatives[1])

    @cached_property
    def ddq(self) -> ca.SX:
        """SX (N, 1)."""
        return ca.mtimes(_sparse(self.linkage.ratios), self._free[1])

    @cached_property
    def dddq(self) -> ca.SX:
        """SX (N, 1)."""
        return ca.mtimes(_sparse(self.linkage.ratios), self._free[2])

    @cached_property
    def ddddq(self) -> ca.SX:
        """SX (N, 1)."""
        return ca.mtimes(_sparse(self.linkage.ratios), self._free[3])

    def lowered(self, torque: ca.SX) -> ca.SX:
        """Gᵀ Γ_tree SX (n, k) of torques of the tree's joints SX (N, k)."""
        return ca.sparsify(ca.mtimes(self.jacobian.T, torque))

    @cached_property
    def _free(self) -> _FreeCoordinates:
        return _FreeCoordinates(self.linkage, self.derivatives)


class _FreeCoordinates:
    """[q_a; x] (0), and its second (1), third (2) and fourth derivative (3); what nobody asks for is not made."""

    def __init__(self, linkage: Linkage, derivatives: tuple[ca.SX, ...]) -> None:
        self._closure, self._given = linkage.closure, derivatives
        self._made: dict[int, ca.SX] = {}

    def __getitem__(self, order: int) -> ca.SX:
        driven = self._given[0 if order == 0 else order + 1]
        if self._closure is None:
            return driven
        if order not in self._made:
            value = self._solved if order == 0 else self._derived(self._closure, order)
            self._made[order] = ca.vertcat(driven, value)
        return self._made[order]

    @cached_property
    def _solved(self) -> ca.SX:
        assert self._closure is not None
        return self._closure.solution(self._given[0])

    def _derived(self, closure: Closure, order: int) -> ca.SX:
        """Made of symbols for x and its rates, so that nothing is differentiated through Newton's method."""
        driven, x = closure.symbols
        names = ("dqa", "ddqa", "dddqa", "ddddqa")
        rates = [ca.SX.sym(name, closure.n) for name in names[: order + 1]]
        known = [driven, *rates[:-1]]
        value = closure.accelerations(driven, x, rates[0], rates[1])
        moving = ca.mtimes(closure.rates(driven, x), rates[0])
        for count in range(1, order):
            state, change = ca.vertcat(*known[: count + 2], x), ca.vertcat(*rates[: count + 2], moving)
            value = ca.jtimes(value, state, change)
        given = [*self._given[: order + 2]]
        return ca.substitute([value], [driven, *rates, x], [*given, self._solved])[0]


def all_positions(robot: Robot, q: ca.SX) -> ca.SX:
    """Positions SX of the driven joints, and behind them of those that follow: `Robot.positions` as an expression."""
    if robot.linkage is None:
        return q
    return ca.vertcat(q, TreeMotion(robot.linkage, (q,)).q[list(robot.linkage.passive)])


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
