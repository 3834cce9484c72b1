"""How the gears of an arm warm up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.scene import FloatArray


@dataclass(frozen=True)
class Warming:
    """Temperatures of the gears in degC: from `room` towards `room` + `rise` in each run's `warmth`, and an unrest.

    `warmth` is the share of the rise that a run starts with; `time` in s; `unrest` in K.
    """

    room: float
    rise: float
    time: float
    warmth: tuple[float, ...]
    unrest: float = 0.8

    def at(self, t: FloatArray, start: float, index: int, n: int) -> FloatArray:
        """(m, n) at the session's times t (m,) of the run that began at `start`; every joint a little another."""
        joints = np.arange(n)
        share = 1.0 - (1.0 - self.warmth[index]) * np.exp(-(t - start) / self.time)
        own = self.rise * (1.0 + 0.1 * np.cos(1.0 + joints))
        restless = self.unrest * np.sin(2 * np.pi * (t[:, None] - start) / 17.0 + 2.0 * joints + index)
        return np.asarray(self.room + share[:, None] * own + restless)
