"""Find collision-free paths between postures, a home posture, and the moves from and to it.

Holds how many postures are tried on the way (60, then 300).

A path is straight, or leads through a few postures around the obstacle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.motion.jerk_limited_moves import find_straight_obstacle, move_within_torque
from dynident.motion.joint_trajectories import Motion, Piece, Rest, concatenate_motions
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, TorqueModel
from dynident.motion.limits.postures_within_limits import (
    compute_static_torque,
    draw_holdable_postures,
    list_usual_homes,
)

# Number of random postures that are tried as home where the usual ones are blocked.
_OTHER_HOMES = 5


@dataclass(frozen=True, eq=False)
class HomeMoves:
    """Moves to the start of the exciting part and back.

    Parameters
    ----------
    approach : Piece
        Motion from home to the start.
    retreat : Piece
        Motion back to home.
    notes : tuple of str
        Where home is, in words for the user.
    """

    approach: Piece
    retreat: Piece
    notes: tuple[str, ...]


# Moves of less time than this (s) cost nothing; exponent of the norm over the joints that stands for the slowest one.
_SHORT_MOVE, _SLOWEST = 0.02, 8.0


@dataclass(frozen=True, eq=False)
class MoveCost:
    """By how much the moves from and to home lengthen an experiment, over coefficients x (m, n) of a family.

    A variance falls with the time at most as fast as 1 / time: where an experiment takes twice as long, the criterion
    of its motion has to be half as large for it to be worth as much.

    Parameters
    ----------
    start : (m,)
        Positions at the start of a period for unit coefficients.
    home : (n,)
        Posture at which the experiment begins and ends, rad or m.
    velocity : (n,)
        Limits of the velocities, rad/s or m/s.
    seconds : float
        Duration of the motion without the moves, s.
    """

    start: FloatArray
    home: FloatArray
    velocity: FloatArray
    seconds: float

    def evaluate(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Return the logarithm of the whole time over that of the motion alone, and its gradient (m, n)."""
        # The slowest joint decides; a norm in its place has a gradient. Accelerations are left out.
        way = (self.start @ x - self.home) / self.velocity
        squares = way**2 + _SHORT_MOVE**2
        longest = float(squares.max())
        powers = (squares / longest) ** (_SLOWEST / 2)
        moves = 2.0 * float(np.sqrt(longest) * powers.sum() ** (1.0 / _SLOWEST))
        of_way = moves * powers / powers.sum() * way / squares
        of_way /= self.velocity * (self.seconds + moves)
        return float(np.log1p(moves / self.seconds)), np.outer(self.start, of_way)


def check_home(stated: Sequence[float], limits: Bounds) -> None:
    """Raise where a posture does not have one position (rad, m) for each joint, or is outside the position limits.

    Parameters
    ----------
    stated : sequence of float
        Positions of the joints, rad or m.
    limits : Bounds
        Limits of all joints.
    """
    home = np.asarray(stated, dtype=np.float64)
    n = len(limits.names)
    if home.shape != (n,) or not np.isfinite(home).all():
        raise DynidentError(f"home must have one position for each of the {n} joints", pointer="/home")
    for name, value, low, high in zip(limits.names, home, limits.position_low, limits.position_high, strict=True):
        if not low <= value <= high:
            raise ImpossibleLimitsError(
                f"home has joint '{name}' at {value:.4g}, outside of its position limits [{low:.4g}, {high:.4g}]",
                pointer="/home",
                title="Impossible limits",
            )


def list_home_candidates(stated: Sequence[float] | None, bounds: Bounds, model: TorqueModel) -> list[FloatArray]:
    """Return the postures to begin at, in the order of preference.

    The stated one alone; else zero where the ranges contain it (their middle where not), then the middle everywhere;
    where neither is clear of all obstacles, others that are.

    Parameters
    ----------
    stated : (n,), optional
        The home posture that the request states, rad or m.
    bounds : Bounds
        Limits of the motion.
    model : TorqueModel
        Model that predicts the torque.

    Returns
    -------
    list of (n,)
        At least one posture, rad or m.

    Raises
    ------
    ImpossibleLimitsError
        None of them can be held within the torque limits, or something is in the way of all of them.
    """
    if stated is not None:
        return [_check_clear(np.asarray(stated, dtype=np.float64), bounds)]
    offered = list_usual_homes(bounds)
    if bounds.has_torque_limits:
        shares = np.abs(compute_static_torque(model, np.array(offered))) / bounds.torque
        offered = [offered[k] for k in np.flatnonzero(shares.max(axis=1) <= 1)]
        if not offered:
            # The joint that is overloaded most even in the better of the postures.
            j = int(np.argmax(shares.min(axis=0)))
            raise ImpossibleLimitsError(
                f"Neither at zero nor in the middle of the ranges can joint '{bounds.names[j]}' hold the arm within "
                f"its torque limit {bounds.torque[j]:.4g}; state a home posture.",
                pointer="/home",
                title="Impossible limits",
            )
    if bounds.space is None:
        return offered
    clear = [posture for posture in offered if bounds.space.find_complaint(posture[None]) is None]
    return clear or list(draw_holdable_postures(bounds, model, np.random.default_rng(0))[:_OTHER_HOMES])


def _check_clear(home: FloatArray, bounds: Bounds) -> FloatArray:
    complaint = None if bounds.space is None else bounds.space.find_complaint(home[None])
    if complaint is not None:
        raise ImpossibleLimitsError(f"At home, {complaint}", pointer="/home", title="Impossible limits")
    return home


def note_home(home: FloatArray) -> str:
    """Return the note that names the home posture."""
    return "Home is " + ", ".join(f"{value:.4g}" for value in home) + "."


def plan_home_moves(
    stated: Sequence[float] | None, start: FloatArray, bounds: Bounds, model: TorqueModel, rate: float
) -> HomeMoves:
    """Return the moves from home to the posture at which the exciting part starts and ends, and back.

    Where no home is stated and none of the usual ones can be reached within the limits, the experiment begins there,
    and a note says so.

    Parameters
    ----------
    stated : sequence of float or None
        The home posture that the request states, rad or m; None for the usual ones.
    start : (n,)
        Posture at which the exciting part starts and ends, rad or m.
    bounds : Bounds
        Limits of the motion.
    model : TorqueModel
        Model that predicts the torque.
    rate : float
        Sampling rate, Hz.

    Returns
    -------
    HomeMoves
        Both moves, and notes.
    """
    try:
        homes = list_home_candidates(stated, bounds, model)
    except ImpossibleLimitsError:
        if stated is not None:
            raise
        # Without a posture to begin at, the motion begins and ends at its own start.
        homes = []
    for home in homes:
        try:
            stations = find_stations(home, start, bounds, model)
            there = plan_moves(stations, bounds, model, rate)
            # Back by the same stations: what was clear on the way there is clear on the way back.
            back = plan_moves(stations[::-1], bounds, model, rate)
        except ImpossibleLimitsError:
            if stated is not None:
                raise
        else:
            return HomeMoves(there, back, (note_home(home),))
    note = (
        "The motion begins and ends where its exciting part does: from zero and from the middle of the ranges, no "
        "path within the limits was found."
    )
    return HomeMoves(Rest(start), Rest(start), (note,))


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
    slack = bounds.space.compute_least_slack(looks.reshape(-1, postures.shape[1])).reshape(len(_LOOKS), -1).min(axis=0)
    clear = legs[slack >= 0]
    graph = scipy.sparse.csr_array((lengths[clear[:, 0], clear[:, 1]], (clear[:, 0], clear[:, 1])), shape=lengths.shape)
    # Undirected: a leg that is clear one way is clear the other way.
    distances, before = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=[0], return_predecessors=True)
    if not np.isfinite(distances[0, 1]):
        return None
    stations = [1]
    # The predecessors lead from the end, which is the second posture, back to the start.
    while stations[0] != 0:
        stations.insert(0, int(before[0, stations[0]]))
    return [postures[k] for k in stations]
