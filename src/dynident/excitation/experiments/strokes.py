"""Motions of one joint at a time (§12.3.3, §12.3.4.2): at constant speeds, slowly over the range, back and forth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.excitation.experiments.task import Made, Task
from dynident.excitation.observation.model import DesignModel
from dynident.excitation.request import DesignRequest
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError
from dynident.motion.limits.locked import moving_joints
from dynident.motion.limits.margins import broken, keeps
from dynident.motion.moves.home import home_candidates, posture_note
from dynident.motion.moves.move import move_within_torque
from dynident.motion.moves.ways import way_between
from dynident.motion.trajectories.motion import Piece
from dynident.progress import Progress, part, silent

# Of the position range, and at most so far (rad, m).
_STROKE_SHARE, _LONGEST_STROKE = 0.8, np.pi
_SWEEP_SHARE, _LONGEST_SWEEP = 0.98, 2 * np.pi
# Of a stroke, what speeding up and slowing down may take.
_RAMP_SHARE = 0.5
_LOOKS_ALONG_A_RANGE = 200
# Of the distance between two looks: how long before the last clear one a stroke ends.
_STOP_BEFORE = 0.5


@dataclass(frozen=True, eq=False)
class Course:
    """Moves (pieces) from home to home; `first` and `last` are the ends in s of the part that identifies."""

    pieces: tuple[Piece, ...]
    first: float
    last: float


@dataclass(frozen=True)
class Stroke:
    """The motion of one joint from `low` to `high` and back at `speed`."""

    joint: int
    low: float
    high: float
    speed: float


def joint_by_joint(task: Task) -> Made:
    """Design motions of one joint at a time, the others at home."""
    request, model, bounds = task.request, task.model, task.bounds
    home = home_candidates(request.home, bounds, model)[0]
    strokes = strokes_of(request, bounds, home)
    course = course_of(
        bounds,
        model,
        home,
        strokes,
        repeats=request.trajectory.periods,
        rate=task.rate,
        progress=part(task.progress, 0.0, 0.9),
    )
    margins = task.verified(course.pieces)
    if not keeps(margins):
        raise broken(margins)
    exciting = (course.first, course.last)
    return Made(
        course.pieces, exciting, None, task.valued(course.pieces, exciting), None, margins, (posture_note(home),)
    )


def strokes_of(request: DesignRequest, bounds: Bounds, home: FloatArray) -> tuple[Stroke, ...]:
    """Return the strokes of a request for a motion of one joint at a time, around home (n,), joint by joint."""
    bounds = clear_ranges(bounds, home)
    joints = [int(j) for j in np.flatnonzero(moving_joints(request.trajectory.joints, bounds.names))]
    if request.kind == "slow_sweep":
        return _sweeps(bounds, joints, request.trajectory.duration)
    if request.kind == "reversals":
        return _reversals(bounds, home, joints, request.wanted_speeds, request.wanted_amplitudes)
    return _constant_speeds(bounds, home, joints, request.wanted_speeds, request.trajectory.duration)


def clear_ranges(bounds: Bounds, home: FloatArray) -> Bounds:
    """Return bounds with the range of every joint cut down to where it is clear while the others are at home (n,)."""
    if bounds.space is None:
        return bounds
    low, high = bounds.position_low.copy(), bounds.position_high.copy()
    for j in range(len(home)):
        for end, step in ((low, -1), (high, 1)):
            reach = np.linspace(home[j], end[j], _LOOKS_ALONG_A_RANGE)
            along = np.tile(home, (len(reach), 1))
            along[:, j] = reach
            hindered = bounds.space.hindered(along)
            if hindered.any():
                last = max(int(hindered.argmax()) - 1, 0)
                # Stop half a look before the last clear position: the obstacle may begin anywhere between two looks.
                end[j] = reach[last] - step * _STOP_BEFORE * abs(reach[1] - reach[0]) if last else home[j]
    return replace(bounds, position_low=low, position_high=high)


def _constant_speeds(
    bounds: Bounds, home: FloatArray, joints: Sequence[int], speeds: Sequence[float], longest: float
) -> tuple[Stroke, ...]:
    """Return strokes as long as the range allows, at most `longest` s, slowest first."""
    strokes = []
    for j in joints:
        room = min(2 * bounds.half_range[j] * _STROKE_SHARE, _LONGEST_STROKE)
        # v² = a d: the speed that is reached within the share of the stroke that both ramps may take.
        reachable = float(np.sqrt(bounds.acceleration[j] * room * _RAMP_SHARE))
        for share in sorted(speeds):
            speed = min(share * float(bounds.velocity[j]), reachable)
            strokes.append(_around(bounds, home, j, min(room, speed * longest), speed))
    return tuple(strokes)


def _sweeps(bounds: Bounds, joints: Sequence[int], duration: float) -> tuple[Stroke, ...]:
    """Return strokes over the whole range, but no more than a turn."""
    strokes = []
    for j in joints:
        length = min(2 * bounds.half_range[j] * _SWEEP_SHARE, _LONGEST_SWEEP)
        speed = min(length / duration, float(bounds.velocity[j]))
        strokes.append(_around(bounds, bounds.middle, j, length, speed))
    return tuple(strokes)


def _reversals(
    bounds: Bounds, home: FloatArray, joints: Sequence[int], speeds: Sequence[float], amplitudes: Sequence[float]
) -> tuple[Stroke, ...]:
    """Return strokes back and forth by growing amplitudes, slowest first."""
    for j in joints:
        if max(amplitudes) > 2 * bounds.half_range[j]:
            raise ImpossibleLimitsError(
                f"Joint '{bounds.names[j]}' cannot go back and forth by {max(amplitudes):.4g}: its range is "
                f"{2 * bounds.half_range[j]:.4g}.",
                pointer="/trajectory/amplitudes",
                title="Impossible limits",
            )
    return tuple(
        _around(bounds, home, j, amplitude, share * float(bounds.velocity[j]))
        for j in joints
        for share in sorted(speeds)
        for amplitude in sorted(amplitudes)
    )


def _around(bounds: Bounds, centre: FloatArray, j: int, length: float, speed: float) -> Stroke:
    low = float(np.clip(centre[j] - length / 2, bounds.position_low[j], bounds.position_high[j] - length))
    return Stroke(j, low, low + length, speed)


def course_of(
    bounds: Bounds,
    model: DesignModel,
    home: FloatArray,
    strokes: Sequence[Stroke],
    *,
    repeats: int,
    rate: float,
    progress: Progress = silent,
) -> Course:
    """Return moves through all strokes, there and back `repeats` times each, the other joints at home.

    Raises
    ------
    ImpossibleLimitsError
        The arm cannot be held somewhere on the way.
    """
    pieces: list[Piece] = []
    posture = home
    for number, stroke in enumerate(strokes):
        progress(number / len(strokes), f"stroke {number + 1} of {len(strokes)}")
        limits = bounds.velocity.copy()
        limits[stroke.joint] = stroke.speed
        slow = replace(bounds, velocity=limits)
        low, high = home.copy(), home.copy()
        low[stroke.joint], high[stroke.joint] = stroke.low, stroke.high
        pieces.append(way_between(posture, low, bounds, model, rate))
        for _ in range(repeats):
            pieces.append(move_within_torque(low, high, slow, model, rate))
            pieces.append(move_within_torque(high, low, slow, model, rate))
        posture = low
    last = sum(piece.duration for piece in pieces)
    first = pieces[0].duration
    pieces.append(way_between(posture, home, bounds, model, rate))
    return Course(tuple(pieces), first, last)
