"""Signals that columns are made of (q, load, temperature, time since start), and operators with memory (Dahl, stop).

Operators update a state along a joint's path; hysteresis and friction after a halt depend on such states. A new
operator is a subclass of `Operator` that is passed to `MemorySignal`; nothing else has to be changed.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import count
from typing import ClassVar, TypeVar, cast

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects.dependent_joint_dynamics import DependentMechanics
from dynident.effects.predicted_torque_expressions import Prediction, count_reference_parameters
from dynident.effects.rigid_body_rows import Mechanics
from dynident.robot.robot_model import Robot

_Built = TypeVar("_Built")
# |z| from which on a state counts as at its stop, in spite of rounding.
_AT_STOP = 1.0 - 1e-12


class Operator(ABC):
    """Update rule of a state z in [-1, 1] along one joint's path, independent of the speed; z begins at 0.

    Displacements are in units of the signal's slip. Two operators of one class with equal attributes are equal.

    Attributes
    ----------
    name : str
        Name of the operator, for symbols.
    forgets_at_halts : bool
        Whether a standstill on the way changes the state.
    """

    name: ClassVar[str]
    forgets_at_halts: ClassVar[bool] = False

    @abstractmethod
    def step(self, state: ca.SX, ratio: ca.SX) -> ca.SX:
        """Return the state after one displacement, as an expression.

        Parameters
        ----------
        state : SX (1, 1)
            State before.
        ratio : SX (1, 1)
            Displacement in units of the slip.

        Returns
        -------
        SX (1, 1)
            In [-1, 1].
        """

    @abstractmethod
    def stroke(self, begun: FloatArray, ratio: FloatArray) -> FloatArray:
        """Return the states along a stroke in one direction.

        Parameters
        ----------
        begun : ndarray (k,)
            States at the beginning of the stroke.
        ratio : ndarray (m, k)
            Displacements since the beginning, in units of the slip.

        Returns
        -------
        ndarray (m, k)
            States in [-1, 1].
        """

    def slopes(self, before: FloatArray, after: FloatArray, ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how states after steps change with the states before and with the displacements.

        Parameters
        ----------
        before, after : ndarray
            States before and after each step, of one shape.
        ratio : ndarray
            Displacements in units of the slip, of that shape.

        Returns
        -------
        passes, follows : ndarray
            ∂z'/∂z and ∂z'/∂ratio, of that shape.
        """
        # By CasADi, which differentiates any operator; those below know their slopes in closed form.
        derivatives = _differentiate(self).map(before.size)(before.reshape(1, -1), ratio.reshape(1, -1))
        passes, follows = (
            np.asarray(ca.DM(derivative), dtype=np.float64).reshape(before.shape) for derivative in derivatives
        )
        return passes, follows

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        # Equal operators are of one class, which is all that a hash must respect; attributes need not be hashable.
        return hash((type(self).__module__, type(self).__qualname__))


class Stop(Operator):
    """z follows Δq / slip, cut at ±1: an element of the generalised Maxwell-slip model (Al-Bender and Swevers 2005)."""

    name = "stop"

    def step(self, state: ca.SX, ratio: ca.SX) -> ca.SX:
        """Return sat(z + Δq / slip)."""
        return ca.fmin(1, ca.fmax(-1, state + ratio))

    def stroke(self, begun: FloatArray, ratio: FloatArray) -> FloatArray:
        """Return sat(z + Δq / slip): in one direction it is cut once."""
        return np.asarray(np.clip(begun + ratio, -1.0, 1.0))

    def slopes(self, before: FloatArray, after: FloatArray, ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return 1 inside, and 0 at the stop, where the past is lost."""
        # Inside, a state passes on as it is and follows the displacement one to one.
        inside = (np.abs(after) < _AT_STOP).astype(np.float64)
        return inside, inside


class Dahl(Operator):
    """dz = dq/slip (1 - z sign q̇) (Dahl 1968)."""

    name = "dahl"

    def step(self, state: ca.SX, ratio: ca.SX) -> ca.SX:
        """Return s - (s - z) exp(-|Δq| / slip) with s = sign Δq."""
        direction = ca.sign(ratio)
        return direction - (direction - state) * ca.exp(-ca.fabs(ratio))

    def stroke(self, begun: FloatArray, ratio: FloatArray) -> FloatArray:
        """Return the formula of `step` over the whole stroke: exponentials multiply."""
        # Toward the stop of this direction the distance to it decays exponentially.
        direction = np.sign(ratio)
        return np.asarray(direction - (direction - begun) * np.exp(-np.abs(ratio)))

    def slopes(self, before: FloatArray, after: FloatArray, ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return exp(-|Δq| / slip), and that times 1 - z sign Δq."""
        decay = np.exp(-np.abs(ratio))
        return decay, (1.0 - np.sign(ratio) * before) * decay


class Travel(Dahl):
    """|z| = 1 - exp(-s / slip), with the motion's sign; s is the way since the joint last turned or stood still."""

    name = "travel"
    forgets_at_halts = True

    def step(self, state: ca.SX, ratio: ca.SX) -> ca.SX:
        """Return Dahl's step, without what was travelled the other way or before a standstill."""
        # A state of the other sign, and any at a standstill, becomes zero before the step.
        direction = ca.sign(ratio)
        return super().step(direction * ca.fmax(0, direction * state), ratio)

    def stroke(self, begun: FloatArray, ratio: FloatArray) -> FloatArray:
        """Return Dahl's stroke, from 0 where the direction has changed."""
        # The last displacement has the direction of the whole stroke. A standstill is a stroke of direction zero, which
        # forgets as a reversal does.
        return super().stroke(np.where(begun * np.sign(ratio[-1]) <= 0, 0.0, begun), ratio)

    def slopes(self, before: FloatArray, after: FloatArray, ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return Dahl's slopes; ∂z'/∂z is 0 where the past is forgotten."""
        forgets = np.sign(ratio) * before <= 0
        passes, follows = super().slopes(np.where(forgets, 0.0, before), after, ratio)
        return np.where(forgets, 0.0, passes), follows


STOP, DAHL, TRAVEL = Stop(), Dahl(), Travel()


@lru_cache(maxsize=64)
def _differentiate(operator: Operator) -> ca.Function:
    """Return the function (z, ratio) -> ∂z'/∂z, ∂z'/∂ratio."""
    state, ratio = ca.SX.sym("z"), ca.SX.sym("ratio")
    after = operator.step(state, ratio)
    return ca.Function("slopes", [state, ratio], [ca.jacobian(after, state), ca.jacobian(after, ratio)])


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


class _SharedSymbols:
    """What signals with the same symbols share: hysteresis states, runs, and what was built, with the states in it."""

    def __init__(self) -> None:
        self.memory: dict[MemorySignal, tuple[str, ca.SX]] = {}
        self.built: dict[Hashable, tuple[object, tuple[MemorySignal, ...]]] = {}
        self.runs: dict[RunSignal, ca.SX] = {}
        # Names are numbered: signals may differ in nothing but their slip. A counter gives no number twice, also to
        # threads that name symbols at once, which the size of a dictionary does.
        self.numbers = count()


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
        self._shared = _SharedSymbols()

    def copy(self) -> Signals:
        """Return signals of the same symbols and known columns, with hysteresis states and runs of their own."""
        own = copy.copy(self)
        own._memory, own._memory_named, own._runs = self._memory.copy(), self._memory_named.copy(), self._runs.copy()
        # The tree's signals ask those of the machine for states and runs: they are its own as well.
        own.of_tree = None
        return own

    def build_once(self, key: Hashable, build: Callable[[], tuple[_Built, ca.SX]]) -> _Built:
        """Return what is built once for all signals with these symbols; `build` gives also an expression of its states.

        The states become known to these signals, whoever built it.
        """
        if key not in self._shared.built:
            built, expression = build()
            # Of two threads that build it at once, both get what the first has built.
            self._shared.built.setdefault(key, (built, self.find_memory_signals(expression)))
        known, states = self._shared.built[key]
        for state in states:
            self.memory(state)
        return cast(_Built, known)

    @property
    def n_built(self) -> int:
        """Number of things that were built and are kept."""
        return len(self._shared.built)

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
            known = self._shared.runs
            if signal not in known:
                known.setdefault(signal, ca.SX.sym(f"run_{next(self._shared.numbers)}"))
            self._runs[signal] = known[signal]
        return self._runs[signal]

    @property
    def run_symbols(self) -> ca.SX:
        """SX (number of run signals, 1): the symbols of all run signals so far."""
        return ca.vertcat(*self._runs.values()) if self._runs else ca.SX(0, 1)

    def find_run_signals(self, expression: ca.SX) -> tuple[RunSignal, ...]:
        """Return the run signals that an expression depends on."""
        used = {symbol.name() for symbol in ca.symvar(expression)}
        return tuple(signal for signal, symbol in list(self._shared.runs.items()) if symbol.name() in used)

    def memory(self, signal: MemorySignal) -> ca.SX:
        """Return the symbol SX (1, 1) of a hysteresis state, the same for equal signals."""
        if signal not in self._memory:
            known = self._shared.memory
            if signal not in known:
                name = f"z_{signal.operator.name}_{signal.joint}_{next(self._shared.numbers)}"
                known.setdefault(signal, (name, ca.SX.sym(name)))
            name, symbol = known[signal]
            self._memory_named[name], self._memory[signal] = signal, symbol
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
