"""Operators that update a state along a joint's path; hysteresis and friction after a halt depend on such states.

A new operator is a subclass of `Operator` that is passed to `MemorySignal`; nothing else has to be changed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache
from typing import ClassVar

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray

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
