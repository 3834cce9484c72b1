"""Evaluate hysteresis operators along a whole path or step by step, with gradients.

The operators depend on the path alone, not on its speed, so between two reversals they have a closed form in the
distance travelled since the last one. A run is therefore evaluated from reversal to reversal, not sample by sample.

Along a sampled path z(k) = step(z(k-1), q(k) - q(k-1)), so the gradient from ∂/∂z back to ∂/∂q is that of a recursion.
Where a stop operator is at its stop, or a joint reverses and forgets its path, the past is lost and the gradient ends
there: it is exact except at the instant at which that happens.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects.effect_signals import MemorySignal


class PathMemory:
    """Hysteresis states of one path, and the gradient of any function of them over the path.

    Parameters
    ----------
    signals : sequence of MemorySignal
        Hysteresis signals, each with its joint and its slip distance.
    """

    def __init__(self, signals: Sequence[MemorySignal]) -> None:
        self.signals = tuple(signals)
        self._joints = np.array([signal.joint for signal in self.signals], dtype=np.intp)
        self._slips = np.array([signal.slip for signal in self.signals])

    def compute_states(self, q: FloatArray, *, periodic: bool) -> FloatArray:
        """Return states (m, k) along q (m, n); of a periodic path those of a later period, with the start forgotten.

        Parameters
        ----------
        q : (m, n)
            Positions along the path, rad or m.
        periodic : bool
            Whether the path is one period of many.
        """
        states = MemoryStates(self.signals)
        # One period before forgets the start: from then on the states repeat with the period.
        if periodic:
            states.push(q)
        return states.push(q)

    def pull_back(self, q: FloatArray, z: FloatArray, gradient: FloatArray) -> FloatArray:
        """Return ∂/∂q (m, n) from ∂/∂z (m, k) on a periodic path q (m, n) with the states z (m, k).

        Parameters
        ----------
        q : (m, n)
            Positions along a periodic path, rad or m.
        z : (m, k)
            Hysteresis states along it.
        gradient : (m, k)
            Derivative of a function by these states.
        """
        gradient_of_path = np.zeros_like(q)
        if not len(self.signals):
            return gradient_of_path
        passes, follows = self._compute_derivatives(q, z)
        carried = np.zeros(len(self.signals))
        of_moves = np.empty_like(z)
        # Twice around: what a sample does to the next period counts as well.
        for _ in range(2):
            # Backwards in time: what a state contributes later is known before what it passes on.
            for k in range(len(q) - 1, -1, -1):
                carried = carried + gradient[k]
                of_moves[k] = carried * follows[k]
                carried = carried * passes[k]
        # `add.at` because several signals may belong to one joint: plain indexing would count only one of them.
        np.add.at(gradient_of_path.T, self._joints, of_moves.T)
        # A move is q(k) - q(k-1): each position enters its own move and, with the opposite sign, the next one.
        np.subtract.at(gradient_of_path.T, self._joints, np.roll(of_moves, -1, axis=0).T)
        return gradient_of_path

    def _compute_derivatives(self, q: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ∂z(k)/∂z(k-1) and ∂z(k)/∂(q(k) - q(k-1)), both (m, k)."""
        path = q[:, self._joints]
        # On a periodic path the sample before the first is the last.
        moves = path - np.roll(path, 1, axis=0)
        before, ratio = np.roll(z, 1, axis=0), moves / self._slips
        passes, follows = np.empty_like(z), np.empty_like(z)
        for k, signal in enumerate(self.signals):
            passes[:, k], follows[:, k] = signal.operator.slopes(before[:, k], z[:, k], ratio[:, k])
        return passes, follows / self._slips


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
        signs = np.sign(np.diff(path))
        # Signals with equal operators go through one array operation, whatever their slips.
        for operator in dict.fromkeys(self.signals[k].operator for k in members):
            own = [k for k in members if self.signals[k].operator == operator]
            # Operators that do not forget give the same states however a stroke is divided.
            strokes = _find_strokes(signs, standstills=operator.forgets_at_halts)
            since = path[1:] - np.repeat(path[strokes[:-1]], np.diff(strokes))
            ratio = since[:, None] / np.array([self.signals[k].slip for k in own])
            states, last = np.empty_like(ratio), self._state[own]
            for rows in itertools.starmap(slice, itertools.pairwise(strokes)):
                states[rows] = operator.stroke(last, ratio[rows])
                last = states[rows.stop - 1]
            out[:, own] = states
            self._state[own] = last


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
