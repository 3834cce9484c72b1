"""Home postures, and the moves between home and the exciting part of an experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, TorqueModel
from dynident.motion.limits.postures import compute_static_torque, draw_holdable_postures, list_usual_homes
from dynident.motion.moves.paths import find_stations, plan_moves
from dynident.motion.trajectories.motion import Piece, Rest

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
        "It begins and ends where the exciting part does: no way from zero or from the middle of the ranges was found "
        "that keeps the limits."
    )
    return HomeMoves(Rest(start), Rest(start), (note,))
