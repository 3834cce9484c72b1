"""Where an experiment begins and ends, and the moves between there and the exciting part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.errors import DynidentError
from dynident.excitation.family import PeriodicMotion
from dynident.excitation.feasible import static_torque
from dynident.excitation.limits import Bounds, ImpossibleLimitsError
from dynident.excitation.model import DesignModel
from dynident.excitation.motion import Piece, Rest
from dynident.excitation.moves import move_within_torque
from dynident.robot.model import FloatArray

# Of half the range: as good as zero.
_NEAR_ZERO = 1e-5


@dataclass(frozen=True, eq=False)
class Placed:
    """The moves to the start of the exciting part and back."""

    approach: Piece
    retreat: Piece
    notes: tuple[str, ...]


def check_home(stated: Sequence[float], limits: Bounds) -> None:
    """Raise where a posture has not one position (rad, m) for each joint, or is outside of its limits."""
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


def home_candidates(stated: Sequence[float] | None, bounds: Bounds, model: DesignModel) -> list[FloatArray]:
    """Postures (n,) to begin at, in the order of preference, at least one.

    The stated one alone; else zero where the ranges have it (their middle where not), then the middle everywhere.

    Raises
    ------
    ImpossibleLimitsError
        None of them can be held within the torque limits.
    """
    if stated is not None:
        return [np.asarray(stated, dtype=np.float64)]
    nearest = np.clip(0.0, bounds.position_low, bounds.position_high)
    offered = [np.where(np.abs(nearest) <= _NEAR_ZERO * bounds.half_range, nearest, bounds.middle), bounds.middle]
    if bounds.checks_torque:
        shares = np.abs(static_torque(model, np.array(offered))) / bounds.torque
        offered = [offered[k] for k in np.flatnonzero(shares.max(axis=1) <= 1)]
        if not offered:
            j = int(np.argmax(shares.min(axis=0)))
            raise ImpossibleLimitsError(
                f"Neither at zero nor in the middle of the ranges can joint '{bounds.names[j]}' hold the arm within "
                f"its torque limit {bounds.torque[j]:.4g}; state a home posture.",
                pointer="/home",
                title="Impossible limits",
            )
    return offered


def posture_note(home: FloatArray) -> str:
    """Home, for the notes."""
    return "Home is " + ", ".join(f"{value:.4g}" for value in home) + "."


def with_moves(
    stated: Sequence[float] | None, motion: PeriodicMotion, bounds: Bounds, model: DesignModel, rate: float
) -> Placed:
    """Moves from home to the motion's start and back, within all limits.

    Where no home is stated and none of the usual ones can be reached within the torque limits, the experiment begins
    at the motion's start, and a note says so.
    """
    start = motion.start
    try:
        homes = home_candidates(stated, bounds, model)
    except ImpossibleLimitsError:
        homes = []
    for home in homes:
        try:
            there = move_within_torque(home, start, bounds, model, rate)
            back = move_within_torque(start, home, bounds, model, rate)
        except ImpossibleLimitsError:
            if stated is not None:
                raise
        else:
            return Placed(there, back, (posture_note(home),))
    note = (
        "It begins and ends where the exciting part does: no straight way from zero or from the middle of the ranges "
        "keeps the torque limits."
    )
    return Placed(Rest(start), Rest(start), (note,))
