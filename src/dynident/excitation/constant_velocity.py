"""Runs at constant velocity, one joint at a time, both ways, at several speeds: for friction (§12.3.3, §12.3.4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.excitation.limits import Bounds
from dynident.excitation.model import DesignModel
from dynident.excitation.motion import Piece
from dynident.excitation.moves import move_within_torque
from dynident.progress import Progress, silent
from dynident.robot.model import FloatArray

# Of the position range, and at most so far (rad, m).
_STROKE_SHARE, _LONGEST_STROKE = 0.8, np.pi
# Of a stroke, what speeding up and slowing down may take.
_RAMP_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Course:
    """Moves (pieces) from home to home; `first` and `last` are the ends in s of the part that identifies."""

    pieces: tuple[Piece, ...]
    first: float
    last: float


@dataclass(frozen=True)
class Stroke:
    """One joint's way from `low` to `high` and back at `speed`."""

    joint: int
    low: float
    high: float
    speed: float


def strokes_of(bounds: Bounds, home: FloatArray, speeds: Sequence[float], longest: float) -> tuple[Stroke, ...]:
    """Strokes of all joints: around home, as far as the range allows, at most `longest` s, slowest first.

    Parameters
    ----------
    home : (n,)
    speeds : shares of the velocity limits
    """
    made = []
    for j in range(len(bounds.names)):
        room = min(2 * bounds.half_range[j] * _STROKE_SHARE, _LONGEST_STROKE)
        reachable = float(np.sqrt(bounds.acceleration[j] * room * _RAMP_SHARE))
        for share in sorted(speeds):
            speed = min(share * float(bounds.velocity[j]), reachable)
            length = min(room, speed * longest)
            low = float(np.clip(home[j] - length / 2, bounds.position_low[j], bounds.position_high[j] - length))
            made.append(Stroke(j, low, low + length, speed))
    return tuple(made)


def constant_velocity_course(
    bounds: Bounds,
    model: DesignModel,
    home: FloatArray,
    strokes: Sequence[Stroke],
    *,
    repeats: int,
    rate: float,
    progress: Progress = silent,
) -> Course:
    """Moves through all strokes, there and back `repeats` times each, the other joints at home.

    Raises
    ------
    ImpossibleLimitsError
        The arm cannot be held somewhere on the way.
    """
    pieces: list[Piece] = []
    at = home
    for number, stroke in enumerate(strokes):
        progress(number / len(strokes), f"stroke {number + 1} of {len(strokes)}")
        limits = bounds.velocity.copy()
        limits[stroke.joint] = stroke.speed
        slow = replace(bounds, velocity=limits)
        low, high = home.copy(), home.copy()
        low[stroke.joint], high[stroke.joint] = stroke.low, stroke.high
        pieces.append(move_within_torque(at, low, bounds, model, rate))
        for _ in range(repeats):
            pieces.append(move_within_torque(low, high, slow, model, rate))
            pieces.append(move_within_torque(high, low, slow, model, rate))
        at = low
    last = sum(piece.duration for piece in pieces)
    first = pieces[0].duration
    pieces.append(move_within_torque(at, home, bounds, model, rate))
    return Course(tuple(pieces), first, last)
