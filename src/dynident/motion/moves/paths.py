"""Collision-free paths between postures: straight, or through a few postures around the obstacle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from dynident.array_types import FloatArray
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, TorqueModel
from dynident.motion.limits.postures import draw_holdable_postures
from dynident.motion.moves.jerk_limited import find_straight_obstacle, move_within_torque
from dynident.motion.trajectories.motion import Motion, Piece, concatenate_motions

# Postures on the way around: a few at first, then more.
_VIA_POSTURES = (60, 300)
# Nearest postures that each posture is joined to, and places along a leg at which it is checked.
_NEIGHBOURS = 12
_LOOKS = np.linspace(0.0, 1.0, 25)


@dataclass(frozen=True, eq=False)
class PieceChain:
    """Pieces of motion one after the other, as one piece.

    Parameters
    ----------
    pieces : tuple of Piece
        The pieces, each of which begins where the one before ends.
    """

    pieces: tuple[Piece, ...]

    @property
    def duration(self) -> float:
        """Sum of the pieces' durations, s."""
        return sum(piece.duration for piece in self.pieces)

    def evaluate(self, t: FloatArray) -> Motion:
        """Return the motion at times t (m,), which ascend."""
        ends = np.cumsum([piece.duration for piece in self.pieces])
        number = np.minimum(np.searchsorted(ends, t, side="right"), len(self.pieces) - 1)
        parts = []
        for k, piece in enumerate(self.pieces):
            if (number == k).any():
                # The clip below is for rounding: a time may lie a hair beyond the piece that it belongs to.
                since = t[number == k] - (ends[k] - piece.duration)
                part = piece.evaluate(np.clip(since, 0.0, piece.duration))
                parts.append(Motion(t[number == k], part.q, part.dq, part.ddq, part.dddq))
        return concatenate_motions(parts)


def plan_path(start: FloatArray, end: FloatArray, bounds: Bounds, model: TorqueModel, rate: float) -> Piece:
    """Return a motion between two postures at rest within all limits: straight, or around what is in the way.

    Parameters
    ----------
    start, end : (n,)
        Postures at the ends, rad or m.
    bounds : Bounds
        Limits of the motion.
    model : TorqueModel
        Model that predicts the torque.
    rate : float
        Sampling rate, Hz.

    Returns
    -------
    Piece
        The motion, at rest at both ends.

    Raises
    ------
    ImpossibleLimitsError
        There is no straight path, and none was found around; the message tells what is in the straight one.
    """
    return plan_moves(find_stations(start, end, bounds, model), bounds, model, rate)


def find_stations(start: FloatArray, end: FloatArray, bounds: Bounds, model: TorqueModel) -> list[FloatArray]:
    """Return postures between which straight paths are clear, both ends among them.

    Parameters
    ----------
    start, end : (n,)
        Postures at the ends, rad or m.
    bounds : Bounds
        Limits of the motion.
    model : TorqueModel
        Model that predicts the torque.

    Returns
    -------
    list of (n,)
        Postures in the order in which they are visited.

    Raises
    ------
    ImpossibleLimitsError
        As in `plan_path`.
    """
    complaint = find_straight_obstacle(start, end, bounds)
    if complaint is None:
        return [start, end]
    try:
        # A fixed seed: the same request has the same way around an obstacle.
        postures = draw_holdable_postures(bounds, model, np.random.default_rng(0))
    except ImpossibleLimitsError:
        raise complaint from None
    # Prefer via postures that cost little extra time.
    detours = (np.abs(postures - start) + np.abs(postures - end)) / bounds.velocity
    shortest = postures[np.argsort(detours.max(axis=1))]
    for count in _VIA_POSTURES:
        # Half of them near the straight way, the others from everywhere.
        near = count // 2
        via = np.concatenate([shortest[:near], shortest[near :: max(1, len(shortest) // near)]])
        stations = _find_shortest_path(np.concatenate([[start, end], via]), bounds)
        if stations is not None:
            return stations
    raise complaint


def plan_moves(stations: Sequence[FloatArray], bounds: Bounds, model: TorqueModel, rate: float) -> Piece:
    """Return moves from posture to posture, at rest in each, within all limits.

    Parameters
    ----------
    stations : sequence of (n,)
        Postures in the order in which they are visited, rad or m.
    bounds : Bounds
        Limits of the motion.
    model : TorqueModel
        Model that predicts the torque.
    rate : float
        Sampling rate, Hz.
    """
    moves = tuple(move_within_torque(a, b, bounds, model, rate) for a, b in pairwise(stations))
    return moves[0] if len(moves) == 1 else PieceChain(moves)


def _find_shortest_path(postures: FloatArray, bounds: Bounds) -> list[FloatArray] | None:
    """Return the shortest path from the first of the postures (m, n) to the second, in clear legs."""
    assert bounds.space is not None
    # As long as the slowest joint takes.
    lengths = (np.abs(postures[:, None] - postures) / bounds.velocity).max(axis=2)
    # A probabilistic roadmap: only legs to the nearest neighbours are checked for collisions, which is what costs time.
    neighbours = np.argsort(lengths, axis=1)[:, 1 : 1 + _NEIGHBOURS]
    legs = np.unique(np.sort([(a, b) for a, row in enumerate(neighbours) for b in row], axis=1), axis=0)
    first, last = postures[legs[:, 0]], postures[legs[:, 1]]
    # All legs in one call: the distances are computed for many postures at once.
    looks = first + _LOOKS[:, None, None] * (last - first)
    room = bounds.space.compute_least_slack(looks.reshape(-1, postures.shape[1])).reshape(len(_LOOKS), -1).min(axis=0)
    clear = legs[room >= 0]
    graph = csr_array((lengths[clear[:, 0], clear[:, 1]], (clear[:, 0], clear[:, 1])), shape=lengths.shape)
    # Undirected: a leg that is clear one way is clear the other way.
    distances, before = dijkstra(graph, directed=False, indices=[0], return_predecessors=True)
    if not np.isfinite(distances[0, 1]):
        return None
    stations = [1]
    # The predecessors lead from the end, which is the second posture, back to the start.
    while stations[0] != 0:
        stations.insert(0, int(before[0, stations[0]]))
    return [postures[k] for k in stations]
