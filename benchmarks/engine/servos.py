"""How firmly a controller holds its joints: what a rate (rad/s) its position loop has on a joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from engine.drives import FloatArray

_SLOWEST = 2 * np.pi * 15.0


class Servo(Protocol):
    """A controller of position and velocity at every joint."""

    @property
    def damping(self) -> float:
        """Damping ratio of the loop."""

    def rate(self, inertia: FloatArray, friction: FloatArray) -> FloatArray:
        """(n,): natural frequencies in rad/s at joints with so much inertia and friction, each (n,)."""


@dataclass(frozen=True)
class Lag:
    """As firm as it takes for friction to make a joint stay behind by no more than `distance` (rad or m).

    The firmer, the shorter a joint sticks at a reversal.
    """

    distance: float = 1.5e-3
    damping: float = 1.0

    def rate(self, inertia: FloatArray, friction: FloatArray) -> FloatArray:
        return np.asarray(np.maximum(_SLOWEST, np.sqrt(friction / self.distance / inertia)))


@dataclass(frozen=True)
class Bandwidth:
    """The same bandwidth in Hz at every joint, whatever friction there is: a soft one lets joints stick for long."""

    hertz: float
    damping: float = 0.8

    def rate(self, inertia: FloatArray, friction: FloatArray) -> FloatArray:
        return np.full(len(inertia), 2 * np.pi * self.hertz)
