"""The signals that effects are functions of, as CasADi symbols of one robot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynident.effects.closed_loops import DependentMechanics
from dynident.effects.hysteresis_operators import Operator
from dynident.effects.mechanics import Mechanics
from dynident.effects.prediction import Prediction, count_reference_parameters
from dynident.robot.model import Robot


@dataclass(frozen=True)
class MemorySignal:
    """A hysteresis state z in [-1, 1] of one joint, which its path up to now determines.

    Parameters
    ----------
    operator : Operator
        Updates the state along the path, independent of the speed.
    joint : int
        Index of the joint, in the order of `Robot.positions`.
    slip : float
        The operator's unit of distance, rad or m.
    """

    operator: Operator
    joint: int
    slip: float


@dataclass(frozen=True)
class RunSignal:
    """A signal that is 1 in the runs with these labels and 0 in all others.

    Parameters
    ----------
    runs : tuple of str
        Labels: a recording's name, or for a segment of it the name with the segment's label ("name#2"). Without any the
        signal is 1 in runs that are marked as carrying a payload.
    """

    runs: tuple[str, ...] = ()


class Signals:
    """Symbols of q and its derivatives, time, temperature, reference parameters, hysteresis states and runs.

    Symbols of hysteresis states (`memory`) and of runs (`in_runs`) are created on first use and then the same.

    Parameters
    ----------
    robot : Robot
        The robot whose driven joints the symbols belong to.
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
        self.dddq = ca.SX.sym("dddq", n)
        self.ddddq = ca.SX.sym("ddddq", n)
        self.time = ca.SX.sym("t")
        # The sampling period: a jump of sign(q̇) is spread over one of it.
        self.period = ca.SX.sym("T")
        self.temperature = ca.SX.sym("temperature", n)
        # Parameters of the model so far, which give the *predicted* torque: a load computed from the measured torque
        # would put its noise into W.
        self.reference = ca.SX.sym("K", count_reference_parameters(robot))
        mechanics = Mechanics if robot.linkage is None else DependentMechanics
        self.mechanics = mechanics(robot, self.q, self.dq, self.ddq)
        # Signals of the tree that carries the links, where some joints follow others (`TreeSignals`).
        self.of_tree: Signals | None = None
        self._smooth_sign = smooth_sign
        self._memory: dict[MemorySignal, ca.SX] = {}
        # By name, because asking CasADi for a symbol's name takes longer than everything else here.
        self._memory_named: dict[str, MemorySignal] = {}
        self._runs: dict[RunSignal, ca.SX] = {}

    @cached_property
    def sign(self) -> ca.SX:
        """SX (n, 1): sign(q̇)."""
        return self.sign_of(self.dq)

    def sign_of(self, velocity: ca.SX) -> ca.SX:
        """Return the sign of a velocity, smoothed if these signals are for a simulator."""
        # A simulator's integrator needs a slope at rest. Data are evaluated sample by sample and need none.
        return ca.tanh(velocity / self._smooth_sign) if self._smooth_sign > 0 else ca.sign(velocity)

    @cached_property
    def sign_rate(self) -> ca.SX:
        """SX (n, 1): the central difference of sign(q̇) over the sampling period: its time derivative, once filtered."""
        # A jump becomes a pulse of finite height at the samples next to it. Its area is right, and the filter that all
        # columns pass spreads it as it spreads the jump itself.
        step = self.ddq * self.period
        return (self.sign_of(self.dq + step) - self.sign_of(self.dq - step)) / (2 * self.period)

    @cached_property
    def sign_curvature(self) -> ca.SX:
        """SX (n, 1): the second central difference of sign(q̇) over the sampling period."""
        step = self.ddq * self.period
        return (self.sign_of(self.dq + step) - 2 * self.sign + self.sign_of(self.dq - step)) / self.period**2

    @cached_property
    def predicted(self) -> Prediction:
        """Torque that the model with the reference parameters predicts."""
        return Prediction(self.robot, self.q, self.dq, self.ddq, self.dddq, self.ddddq, self.sign, self.reference)

    @property
    def load(self) -> ca.SX:
        """SX (n, 1): the load torque that the links with the reference parameters predict (N m, N)."""
        return self.predicted.load

    def in_runs(self, signal: RunSignal) -> ca.SX:
        """Return the symbol SX (1, 1) that is 1 in the signal's runs."""
        if signal not in self._runs:
            self._runs[signal] = ca.SX.sym(f"run_{len(self._runs)}")
        return self._runs[signal]

    @property
    def run_symbols(self) -> ca.SX:
        """SX (number of run signals, 1): the symbols of all run signals so far."""
        return ca.vertcat(*self._runs.values()) if self._runs else ca.SX(0, 1)

    def find_run_signals(self, expression: ca.SX) -> tuple[RunSignal, ...]:
        """Return the run signals that an expression depends on."""
        used = {symbol.name() for symbol in ca.symvar(expression)}
        return tuple(signal for signal, symbol in self._runs.items() if symbol.name() in used)

    def memory(self, signal: MemorySignal) -> ca.SX:
        """Return the symbol SX (1, 1) of a hysteresis state, the same for equal signals."""
        if signal not in self._memory:
            # The running number keeps names apart: signals may differ in nothing but their slip.
            name = f"z_{signal.operator.name}_{signal.joint}_{len(self._memory)}"
            self._memory[signal], self._memory_named[name] = ca.SX.sym(name), signal
        return self._memory[signal]

    @property
    def memory_signals(self) -> tuple[MemorySignal, ...]:
        """All hysteresis states so far, in the order of `memory_symbols`."""
        return tuple(self._memory)

    @property
    def memory_symbols(self) -> ca.SX:
        """SX (number of memory signals, 1)."""
        return ca.vertcat(*self._memory.values()) if self._memory else ca.SX(0, 1)

    def find_memory_signals(self, expression: ca.SX) -> tuple[MemorySignal, ...]:
        """Return the hysteresis states that an expression depends on."""
        used = {symbol.name() for symbol in ca.symvar(expression)}
        return tuple(signal for name, signal in self._memory_named.items() if name in used)
