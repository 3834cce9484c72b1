"""The signals that effects are functions of, as CasADi symbols of one robot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import casadi as ca

from dynident.effects.mechanics import Mechanics
from dynident.robot.model import Robot

Operator = Literal["stop", "dahl"]


@dataclass(frozen=True)
class MemorySignal:
    """A hysteresis state z in [-1, 1] of one joint: what the joint's path up to now has left behind.

    `stop`: z follows Δq / slip and is cut at ±1 (an element of the generalised Maxwell-slip model, Al-Bender and
    Swevers 2005). `dahl`: dz = dq/slip (1 - z sign q̇) (Dahl 1968). Neither depends on how fast the path is travelled.
    """

    operator: Operator
    joint: int
    slip: float


class Signals:
    """Symbols of q, q̇, q̈, time, temperature, the reference parameters and the memory signals asked for so far.

    Parameters
    ----------
    robot : Robot
    smooth_sign : float
        0: sign(q̇) as such, for data. Above 0: q̇ is divided by it inside a hyperbolic tangent, so that a simulator's
        friction has a slope at rest (rad/s or m/s).
    """

    def __init__(self, robot: Robot, *, smooth_sign: float = 0.0) -> None:
        self.robot = robot
        n = robot.n
        self.q = ca.SX.sym("q", n)
        self.dq = ca.SX.sym("dq", n)
        self.ddq = ca.SX.sym("ddq", n)
        self.time = ca.SX.sym("t")
        self.temperature = ca.SX.sym("temperature", n)
        # Standard inertial parameters of the model so far: they carry the *predicted* load torque, since a load taken
        # from the measured torque would put the measurement's noise into W.
        self.reference = ca.SX.sym("K", 10 * n)
        self.mechanics = Mechanics(robot, self.q, self.dq, self.ddq)
        self._smooth_sign = smooth_sign
        self._memory: dict[MemorySignal, ca.SX] = {}

    @cached_property
    def sign(self) -> ca.SX:
        """SX (n, 1): sign(q̇)."""
        return self.sign_of(self.dq)

    def sign_of(self, velocity: ca.SX) -> ca.SX:
        """The sign of a velocity, smoothed where this set of signals is."""
        return ca.tanh(velocity / self._smooth_sign) if self._smooth_sign > 0 else ca.sign(velocity)

    @cached_property
    def load(self) -> ca.SX:
        """SX (n, 1): the load torque that the rigid-body model with the reference parameters predicts (N m, N)."""
        return ca.mtimes(self.mechanics.rows, self.reference)

    def memory(self, signal: MemorySignal) -> ca.SX:
        """SX (1, 1): the symbol of a hysteresis state, the same for the same signal."""
        if signal not in self._memory:
            self._memory[signal] = ca.SX.sym(f"z_{signal.operator}_{signal.joint}_{len(self._memory)}")
        return self._memory[signal]

    @property
    def memory_signals(self) -> tuple[MemorySignal, ...]:
        """The hysteresis states asked for, in the order of `memory_symbols`."""
        return tuple(self._memory)

    @property
    def memory_symbols(self) -> ca.SX:
        """SX (number of memory signals, 1)."""
        return ca.vertcat(*self._memory.values()) if self._memory else ca.SX(0, 1)

    def memory_in(self, expression: ca.SX) -> tuple[MemorySignal, ...]:
        """The hysteresis states that an expression depends on, of all that were ever asked for."""
        used = {symbol.name() for symbol in ca.symvar(expression)}
        return tuple(signal for signal, symbol in self._memory.items() if symbol.name() in used)
