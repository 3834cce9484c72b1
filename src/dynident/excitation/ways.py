"""Ways between postures that touch nothing: straight, or through a few postures on the way around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import dijkstra

from dynident.excitation.feasible import holdable_postures
from dynident.excitation.limits import Bounds, ImpossibleLimitsError
from dynident.excitation.model import DesignModel
from dynident.excitation.motion import Motion, Piece, joined
from dynident.excitation.moves import move_within_torque
from dynident.robot.model import FloatArray

_VIA_POSTURES = 40
_MOST_LEGS_TRIED = 150


@dataclass(frozen=True, eq=False)
class Chain:
    """Pieces one after the other, as one."""

    pieces: tuple[Piece, ...]

    @property
    def duration(self) -> float:
        """Seconds of all pieces."""
        return sum(piece.duration for piece in self.pieces)

    def evaluate(self, t: FloatArray) -> Motion:
        """The motion at times t (m,), which ascend."""
        ends = np.cumsum([piece.duration for piece in self.pieces])
        number = np.minimum(np.searchsorted(ends, t, side="right"), len(self.pieces) - 1)
        parts = []
        for k, piece in enumerate(self.pieces):
            if (number == k).any():
                since = t[number == k] - (ends[k] - piece.duration)
                part = piece.evaluate(np.clip(since, 0.0, piece.duration))
                parts.append(Motion(t[number == k], part.q, part.dq, part.ddq, part.dddq))
        return joined(parts)


def way_between(start: FloatArray, end: FloatArray, bounds: Bounds, model: DesignModel, rate: float) -> Piece:
    """A motion between two postures (n,) at rest within all limits: straight, or around what is in the way.

    Raises
    ------
    ImpossibleLimitsError
        There is no straight way, and none was found around; the message tells what is in the straight one.
    """
    try:
        return move_within_torque(start, end, bounds, model, rate)
    except ImpossibleLimitsError as straight:
        if bounds.space is None:
            raise
        try:
            postures = holdable_postures(bounds, model, np.random.default_rng(0))[:_VIA_POSTURES]
        except ImpossibleLimitsError:
            raise straight from None
        around = _Around(np.concatenate([[start, end], postures]), bounds, model, rate).shortest()
        if around is None:
            raise straight
        return Chain(around)


class _Around:
    """The shortest way from the first posture to the second through others; legs are planned when they are on it."""

    def __init__(self, postures: FloatArray, bounds: Bounds, model: DesignModel, rate: float) -> None:
        self._postures, self._bounds, self._model, self._rate = postures, bounds, model, rate
        self._planned: dict[tuple[int, int], Piece] = {}
        # As long as the slowest joint takes.
        apart = np.abs(postures[:, None] - postures) / bounds.velocity
        self._lengths = apart.max(axis=2) + 1e-9
        self._lengths[0, 1] = self._lengths[1, 0] = np.inf

    def shortest(self) -> tuple[Piece, ...] | None:
        for _ in range(_MOST_LEGS_TRIED):
            stations = self._stations()
            if stations is None:
                return None
            legs = list(pairwise(stations))
            if self._plan(legs):
                return tuple(self._planned[leg] for leg in legs)
        return None

    def _stations(self) -> list[int] | None:
        open_ways = np.where(np.isfinite(self._lengths), self._lengths, 0.0)
        lengths, before = dijkstra(open_ways, indices=[0], return_predecessors=True)
        if not np.isfinite(lengths[0, 1]):
            return None
        stations = [1]
        while stations[0] != 0:
            stations.insert(0, int(before[0, stations[0]]))
        return stations

    def _plan(self, legs: Sequence[tuple[int, int]]) -> bool:
        """Whether all legs keep the limits; the first that does not is taken out."""
        for a, b in legs:
            if (a, b) in self._planned:
                continue
            try:
                self._planned[a, b] = move_within_torque(
                    self._postures[a], self._postures[b], self._bounds, self._model, self._rate
                )
            except ImpossibleLimitsError:
                self._lengths[a, b] = self._lengths[b, a] = np.inf
                return False
        return True
