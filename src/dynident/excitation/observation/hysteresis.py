"""Hysteresis states along a sampled path, and the reverse sweep from ∂/∂z back to ∂/∂q.

A state depends on the path alone, z(k) = step(z(k-1), q(k) - q(k-1)), so its gradient is that of a recursion. Where a
stop operator is at its stop, or a joint reverses and forgets its path, the past is lost and the gradient ends
there: it is exact except at the instant at which that happens.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import MemorySignal
from dynident.effects.hysteresis_states import MemoryStates


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
