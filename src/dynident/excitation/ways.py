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
from dynident.excitation.moves import move_within_torque, straight_complaint
from dynident.robot.model import FloatArray

# Postures on the way around: the nearest ones, and others from everywhere.
_NEAR_VIA, _FAR_VIA = 60, 40
_MOST_WAYS_TRIED = 300
_LOOKS = 60


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
    return moves_through(stations_between(start, end, bounds, model), bounds, model, rate)


def stations_between(start: FloatArray, end: FloatArray, bounds: Bounds, model: DesignModel) -> list[FloatArray]:
    """Postures (n,), both ends among them, between which the straight ways are clear; raises as `way_between`."""
    complaint = straight_complaint(start, end, bounds)
    if complaint is None:
        return [start, end]
    try:
        postures = holdable_postures(bounds, model, np.random.default_rng(0))
    except ImpossibleLimitsError:
        raise complaint from None
    detours = (np.abs(postures - start) + np.abs(postures - end)) / bounds.velocity
    shortest = postures[np.argsort(detours.max(axis=1))]
    around = np.concatenate([shortest[:_NEAR_VIA], shortest[_NEAR_VIA :: max(1, len(shortest) // _FAR_VIA)]])
    found = _Around(np.concatenate([[start, end], around]), bounds).stations()
    if found is None:
        raise complaint
    return found


def moves_through(stations: Sequence[FloatArray], bounds: Bounds, model: DesignModel, rate: float) -> Piece:
    """Moves from posture to posture, at rest in each, within all limits."""
    moves = tuple(move_within_torque(a, b, bounds, model, rate) for a, b in pairwise(stations))
    return moves[0] if len(moves) == 1 else Chain(moves)


class _Around:
    """The shortest way from the first posture to the second through others.

    Only ways that the enclosing capsules keep clear are taken, and they are looked at when the shortest way has them.
    """

    def __init__(self, postures: FloatArray, bounds: Bounds) -> None:
        self._postures, self._bounds = postures, bounds
        # As long as the slowest joint takes.
        self._lengths = (np.abs(postures[:, None] - postures) / bounds.velocity).max(axis=2) + 1e-9
        self._lengths[0, 1] = self._lengths[1, 0] = np.inf
        self._clear: set[tuple[int, int]] = set()

    def stations(self) -> list[FloatArray] | None:
        for _ in range(_MOST_WAYS_TRIED):
            stations = self._shortest()
            if stations is None:
                return None
            hindered = [leg for leg in pairwise(stations) if not self._is_clear(leg)]
            if not hindered:
                return [self._postures[k] for k in stations]
            for a, b in hindered:
                self._lengths[a, b] = self._lengths[b, a] = np.inf
        return None

    def _shortest(self) -> list[int] | None:
        open_ways = np.where(np.isfinite(self._lengths), self._lengths, 0.0)
        lengths, before = dijkstra(open_ways, indices=[0], return_predecessors=True)
        if not np.isfinite(lengths[0, 1]):
            return None
        stations = [1]
        while stations[0] != 0:
            stations.insert(0, int(before[0, stations[0]]))
        return stations

    def _is_clear(self, leg: tuple[int, int]) -> bool:
        if leg not in self._clear and self._bounds.space is not None:
            start, end = self._postures[list(leg)]
            way = start + np.linspace(0.0, 1.0, _LOOKS)[:, None] * (end - start)
            if not (self._bounds.space.least_room(way) >= 0).all():
                return False
            self._clear.add(leg)
        return True
