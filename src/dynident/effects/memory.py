"""Hysteresis states: what a joint's path up to now has left behind, sample by sample and one step at a time.

Both operators depend on the path alone, not on its speed, so between two reversals they have a closed form in the
distance travelled since the last one. A run is therefore evaluated by walking over its reversals, not its samples.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from dynident.effects.signals import MemorySignal
from dynident.robot.model import FloatArray


def step(signal: MemorySignal, state: float, displacement: float) -> float:
    """The state after the joint has moved on by `displacement` (rad or m)."""
    if signal.operator == "stop":
        return min(1.0, max(-1.0, state + displacement / signal.slip))
    direction = float(np.sign(displacement))
    return direction - (direction - state) * float(np.exp(-abs(displacement) / signal.slip))


class MemoryStates:
    """Hysteresis states of one run, fed block by block; exact across block borders.

    Parameters
    ----------
    signals : sequence of MemorySignal
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
        """States (m, number of signals) along the next positions q (m, n)."""
        out = np.empty((len(q), len(self.signals)))
        if not self.signals or not len(q):
            return out
        before = q[0] if self._last is None else self._last
        for joint in self._joints:
            members = [k for k, signal in enumerate(self.signals) if signal.joint == joint]
            self._walk(np.concatenate(([before[joint]], q[:, joint])), members, out)
        self._last = q[-1].copy()
        return out

    def _walk(self, path: FloatArray, members: list[int], out: FloatArray) -> None:
        """Fill the columns `members` of `out` (m, …) along `path` (m + 1,), whose first point is the last one known."""
        slips = np.array([self.signals[k].slip for k in members])
        stops = np.array([self.signals[k].operator == "stop" for k in members])
        state = self._state[members]
        moves = np.sign(np.diff(path))
        # A sample without movement belongs to the stroke before it.
        turns = np.flatnonzero(np.diff(moves[moves != 0]) != 0)
        moving = np.flatnonzero(moves)
        borders = [0, *(int(moving[k + 1]) for k in turns), len(moves)]
        for first, last in itertools.pairwise(borders):
            travelled = path[first + 1 : last + 1, None] - path[first]
            ratio = travelled / slips
            direction = np.sign(travelled)
            sliding = np.clip(state + ratio, -1.0, 1.0)
            if not stops.all():
                dahl = direction - (direction - state) * np.exp(-np.abs(ratio))
                sliding = np.where(stops, sliding, dahl)
            out[first:last, members] = sliding
            state = sliding[-1]
        self._state[members] = state
