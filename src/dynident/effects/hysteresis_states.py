"""Hysteresis states along a joint's path, for whole recordings or one step at a time.

The operators depend on the path alone, not on its speed, so between two reversals they have a closed form in the
distance travelled since the last one. A run is therefore evaluated from reversal to reversal, not sample by sample.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects.signals import MemorySignal


def step_state(signal: MemorySignal, state: float, displacement: float) -> float:
    """Return a hysteresis state after its joint has moved on.

    Parameters
    ----------
    signal : MemorySignal
        Operator and slip of the state.
    state : float
        State before, in [-1, 1].
    displacement : float
        rad or m.

    Returns
    -------
    float
        State after, in [-1, 1].
    """
    return float(signal.operator.stroke(np.array([state]), np.array([[displacement / signal.slip]]))[0, 0])


def build_step_expression(signal: MemorySignal, state: ca.SX, displacement: ca.SX) -> ca.SX:
    """Return the state after a displacement, as `step_state` does, as an expression SX (1, 1).

    Parameters
    ----------
    signal : MemorySignal
        Operator and slip of the state.
    state, displacement : SX (1, 1)
        State before, and displacement in rad or m.

    Returns
    -------
    SX (1, 1)
        State after.
    """
    return signal.operator.step(state, displacement / signal.slip)


class MemoryStates:
    """Hysteresis states of one run whose positions come in blocks; the borders of blocks do not change the result.

    Parameters
    ----------
    signals : sequence of MemorySignal
        The states to follow, in the order of the results.
    """

    def __init__(self, signals: Sequence[MemorySignal]) -> None:
        self.signals = tuple(signals)
        self._joints = sorted({signal.joint for signal in self.signals})
        self.restart()

    def restart(self) -> None:
        """Forget the past: a new run begins, with every element relaxed."""
        self._last: FloatArray | None = None
        self._state = np.zeros(len(self.signals))

    def push(self, q: FloatArray) -> FloatArray:
        """Return states (m, number of signals) along the next positions q (m, n)."""
        out = np.empty((len(q), len(self.signals)))
        if not self.signals or not len(q):
            return out
        # The last position of the block before, so that the first move of this one is known; a run begins with no move.
        before = q[0] if self._last is None else self._last
        for joint in self._joints:
            members = [k for k, signal in enumerate(self.signals) if signal.joint == joint]
            self._follow_path(np.concatenate(([before[joint]], q[:, joint])), members, out)
        self._last = q[-1].copy()
        return out

    def _follow_path(self, path: FloatArray, members: list[int], out: FloatArray) -> None:
        """Fill the columns `members` of `out` (m, …) along `path` (m + 1,), whose first point is the last one known."""
        # Signals with equal operators go through one array operation, whatever their slips.
        slips = np.array([self.signals[k].slip for k in members])
        operators = [self.signals[k].operator for k in members]
        groups = [
            (operator, [i for i, other in enumerate(operators) if other == operator])
            for operator in dict.fromkeys(operators)
        ]
        # Operators that do not forget give the same states however a stroke is divided.
        halts = any(operator.forgets_at_halts for operator in operators)
        state = self._state[members]
        for first, last in itertools.pairwise(_find_strokes(np.sign(np.diff(path)), standstills=halts)):
            ratio = (path[first + 1 : last + 1, None] - path[first]) / slips
            sliding = np.empty_like(ratio)
            for operator, places in groups:
                sliding[:, places] = operator.stroke(state[places], ratio[:, places])
            out[first:last, members] = sliding
            state = sliding[-1]
        self._state[members] = state


def _find_strokes(moves: FloatArray, *, standstills: bool) -> list[int]:
    """Return the index of the first move of each stroke in one direction, followed by the number of all moves.

    Moves are given by their signs (m,). A sample without movement belongs to the stroke before it, unless standstills
    are strokes of their own.
    """
    counted = np.arange(len(moves)) if standstills else np.flatnonzero(moves)
    # A pause within one direction does not end a stroke: unless standstills count, samples without movement are left
    # out.
    turns = np.flatnonzero(np.diff(moves[counted]) != 0)
    return [0, *(int(counted[k + 1]) for k in turns), len(moves)]
