"""Spaces of point sequences to search in: what is free, how a sequence is drawn, how it is varied."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynident.arrays import FloatArray
from dynident.excitation.points.sequence import PointSequence
from dynident.motion.limits.bounds import Bounds

_SMALLEST_SHARE = 0.2
_FRESH = 0.1
"""Probability that a point is drawn again instead of being moved."""


class PointSpace(Protocol):
    """Sequences to search in."""

    def draw(self, rng: np.random.Generator) -> PointSequence:
        """Return a random sequence."""

    def redraw(self, sequence: PointSequence, k: int, rng: np.random.Generator) -> PointSequence:
        """Return another one, drawn because the move to point k breaks a limit."""

    def vary(self, sequence: PointSequence, rng: np.random.Generator, size: float) -> PointSequence:
        """Return a neighbour; `size` is in shares of the ranges."""


@dataclass(frozen=True, eq=False)
class FreePoints:
    """`count` free points, and free shares of the velocity and acceleration limits up to `fastest`.

    `postures` (m, n) are those that points are drawn from.
    """

    bounds: Bounds
    postures: FloatArray
    count: int
    fastest: float = 1.0

    def draw(self, rng: np.random.Generator) -> PointSequence:
        """Return random postures that can be held."""
        points = self.postures[rng.integers(len(self.postures), size=self.count)]
        shares = self.fastest * rng.uniform(_SMALLEST_SHARE, 1.0, (self.count, 2))
        return PointSequence(points, shares)

    def redraw(self, sequence: PointSequence, k: int, rng: np.random.Generator) -> PointSequence:
        """Return a sequence with another point k.

        Everything begins from the first point: instead of it, the last one is drawn again.
        """
        points = sequence.points.copy()
        points[k if k else -1] = self.postures[rng.integers(len(self.postures))]
        return PointSequence(points, sequence.shares)

    def vary(self, sequence: PointSequence, rng: np.random.Generator, size: float) -> PointSequence:
        """Return a sequence with one point moved, and other shares for the two moves that it belongs to."""
        points, shares = sequence.points.copy(), sequence.shares.copy()
        k = int(rng.integers(self.count))
        if rng.random() < _FRESH:
            points[k] = self.postures[rng.integers(len(self.postures))]
        else:
            points[k] = _clip_posture(
                self.bounds, points[k] + size * self.bounds.half_range * rng.standard_normal(len(points[k]))
            )
        touched = [k, (k + 1) % self.count]
        shares[touched] += self.fastest * size * rng.standard_normal((2, 2))
        low, high = _SMALLEST_SHARE * self.fastest, self.fastest
        return PointSequence(points, np.clip(shares, low, high))


@dataclass(frozen=True, eq=False)
class TwoPoints:
    """Back and forth between two points around a free posture, as fast as the limits allow.

    `shortest` and `longest` (n,) are how far each joint goes: zero for those that are locked, wherever the posture has
    them.
    """

    bounds: Bounds
    postures: FloatArray
    shortest: FloatArray
    longest: FloatArray

    def draw(self, rng: np.random.Generator) -> PointSequence:
        """Return a sequence around a random posture that can be held."""
        way = rng.uniform(self.shortest, self.longest) * rng.choice([-1.0, 1.0], len(self.shortest))
        return self._build_around(self.postures[rng.integers(len(self.postures))], way)

    def redraw(self, sequence: PointSequence, k: int, rng: np.random.Generator) -> PointSequence:
        """Return a sequence around another posture."""
        return self.draw(rng)

    def vary(self, sequence: PointSequence, rng: np.random.Generator, size: float) -> PointSequence:
        """Return a sequence around a nearby posture, by other distances."""
        middle = sequence.points.mean(axis=0) + size * self.bounds.half_range * rng.standard_normal(len(self.shortest))
        way = sequence.points[1] - sequence.points[0]
        length = np.abs(way) + size * self.longest * rng.standard_normal(len(way))
        sign = np.where(rng.random(len(way)) < _FRESH, -1.0, 1.0) * np.where(way < 0, -1.0, 1.0)
        return self._build_around(
            _clip_posture(self.bounds, middle), sign * np.clip(length, self.shortest, self.longest)
        )

    def _build_around(self, middle: FloatArray, way: FloatArray) -> PointSequence:
        room = self.bounds.half_range - np.abs(way) / 2
        centre = np.clip(middle, self.bounds.middle - room, self.bounds.middle + room)
        return PointSequence(np.stack([centre - way / 2, centre + way / 2]), np.ones((2, 2)))


def _clip_posture(bounds: Bounds, posture: FloatArray) -> FloatArray:
    """Return a posture moved inside the position limits."""
    return np.clip(posture, bounds.position_low, bounds.position_high)
