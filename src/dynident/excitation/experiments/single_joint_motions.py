"""Motions of one joint at a time: constant speeds, slow sweeps, back and forth (§12.3.3); free of obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.excitation.design_observation_matrix import DesignModel
from dynident.excitation.design_request import DesignRequest
from dynident.excitation.experiments.design_task import DesignedExperiment, DesignTask
from dynident.motion.collision_free_paths import list_home_candidates, note_home, plan_path
from dynident.motion.jerk_limited_moves import move_within_torque
from dynident.motion.joint_trajectories import Piece
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, select_moving_joints
from dynident.motion.limits.limit_margins import are_limits_kept, build_limit_error
from dynident.progress import Progress, ignore_progress, scale_progress

# Of the position range, and at most so far (rad, m).
_STROKE_SHARE, _LONGEST_STROKE = 0.8, np.pi
_SWEEP_SHARE, _LONGEST_SWEEP = 0.98, 2 * np.pi
# Of a stroke, what speeding up and slowing down may take.
_RAMP_SHARE = 0.5
# Postures between home and the end of a range that are looked at for obstacles.
_LOOKS_ALONG_A_RANGE = 200
# Of the distance between two looks: how long before the last clear one a stroke ends.
_STOP_BEFORE = 0.5


@dataclass(frozen=True, eq=False)
class StrokeSequence:
    """Moves of one joint at a time, from home to home.

    Parameters
    ----------
    pieces : tuple of Piece
        Moves from home to home.
    first : float
        Time at which the part that identifies begins, s.
    last : float
        Time at which it ends, s.
    """

    pieces: tuple[Piece, ...]
    first: float
    last: float


@dataclass(frozen=True)
class Stroke:
    """The motion of one joint between two positions and back.

    Parameters
    ----------
    joint : int
        Index of the joint.
    low : float
        Position at one end, rad or m.
    high : float
        Position at the other end, rad or m.
    speed : float
        Speed between the ends, rad/s or m/s.
    """

    joint: int
    low: float
    high: float
    speed: float


def design_joint_by_joint(task: DesignTask) -> DesignedExperiment:
    """Design motions of one joint at a time, the others at home."""
    request, model, bounds = task.request, task.model, task.bounds
    home = list_home_candidates(request.home, bounds, model)[0]
    strokes = plan_strokes(request, bounds, home)
    course = plan_stroke_moves(
        bounds,
        model,
        home,
        strokes,
        repeats=request.trajectory.periods,
        rate=task.rate,
        progress=scale_progress(task.progress, 0.0, 0.9),
    )
    margins = task.verify_pieces(course.pieces)
    if not are_limits_kept(margins):
        raise build_limit_error(margins)
    exciting = (course.first, course.last)
    return DesignedExperiment(
        course.pieces, exciting, None, task.evaluate_pieces(course.pieces, exciting), None, margins, (note_home(home),)
    )


def plan_strokes(request: DesignRequest, bounds: Bounds, home: FloatArray) -> tuple[Stroke, ...]:
    """Return the strokes of a request for a motion of one joint at a time, around home, joint by joint.

    Parameters
    ----------
    request : DesignRequest
        The design request.
    bounds : Bounds
        Limits of the motion.
    home : (n,)
        Posture of the other joints, rad or m.

    Returns
    -------
    tuple of Stroke
        Strokes in the order in which they are made.
    """
    bounds = restrict_to_clear(bounds, home)
    joints = [int(j) for j in np.flatnonzero(select_moving_joints(request.trajectory.joints, bounds.names))]
    if request.kind == "slow_sweep":
        return _plan_sweeps(bounds, joints, request.trajectory.duration)
    if request.kind == "reversals":
        return _plan_reversals(bounds, home, joints, request.speeds_or_default, request.amplitudes_or_default)
    return _plan_constant_speeds(bounds, home, joints, request.speeds_or_default, request.trajectory.duration)


def restrict_to_clear(bounds: Bounds, home: FloatArray) -> Bounds:
    """Return bounds with the range of every joint cut down to where it is clear while the others are at home (n,)."""
    if bounds.space is None:
        return bounds
    low, high = bounds.position_low.copy(), bounds.position_high.copy()
    for j in range(len(home)):
        # From home outwards to either end: what lies behind the first obstacle cannot be reached.
        for end, step in ((low, -1), (high, 1)):
            reach = np.linspace(home[j], end[j], _LOOKS_ALONG_A_RANGE)
            along = np.tile(home, (len(reach), 1))
            along[:, j] = reach
            hindered = bounds.space.find_blocked(along)
            if hindered.any():
                last = max(int(hindered.argmax()) - 1, 0)
                # Stop half a look before the last clear position: the obstacle may begin anywhere between two looks.
                end[j] = reach[last] - step * _STOP_BEFORE * abs(reach[1] - reach[0]) if last else home[j]
    return replace(bounds, position_low=low, position_high=high)


def _plan_constant_speeds(
    bounds: Bounds, home: FloatArray, joints: Sequence[int], speeds: Sequence[float], longest: float
) -> tuple[Stroke, ...]:
    """Return strokes as long as the range allows, at most `longest` s, slowest first."""
    strokes = []
    for j in joints:
        longest_way = min(2 * bounds.half_range[j] * _STROKE_SHARE, _LONGEST_STROKE)
        # v² = a d: the speed that is reached within the share of the stroke that both ramps may take.
        reachable = float(np.sqrt(bounds.acceleration[j] * longest_way * _RAMP_SHARE))
        for share in sorted(speeds):
            # A short range does not allow the fastest speeds: there the joint would only speed up and slow down.
            speed = min(share * float(bounds.velocity[j]), reachable)
            strokes.append(_center_stroke(bounds, home, j, min(longest_way, speed * longest), speed))
    return tuple(strokes)


def _plan_sweeps(bounds: Bounds, joints: Sequence[int], duration: float) -> tuple[Stroke, ...]:
    """Return strokes over the whole range, but no more than a turn."""
    strokes = []
    for j in joints:
        length = min(2 * bounds.half_range[j] * _SWEEP_SHARE, _LONGEST_SWEEP)
        speed = min(length / duration, float(bounds.velocity[j]))
        strokes.append(_center_stroke(bounds, bounds.middle, j, length, speed))
    return tuple(strokes)


def _plan_reversals(
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
        _center_stroke(bounds, home, j, amplitude, share * float(bounds.velocity[j]))
        for j in joints
        for share in sorted(speeds)
        for amplitude in sorted(amplitudes)
    )


def _center_stroke(bounds: Bounds, centre: FloatArray, j: int, length: float, speed: float) -> Stroke:
    # A stroke that would leave the range is moved inwards, not shortened.
    low = float(np.clip(centre[j] - length / 2, bounds.position_low[j], bounds.position_high[j] - length))
    return Stroke(j, low, low + length, speed)


def plan_stroke_moves(
    bounds: Bounds,
    model: DesignModel,
    home: FloatArray,
    strokes: Sequence[Stroke],
    *,
    repeats: int,
    rate: float,
    progress: Progress = ignore_progress,
) -> StrokeSequence:
    """Return moves through all strokes, there and back, the other joints at home.

    Parameters
    ----------
    bounds : Bounds
        Limits of the motion.
    model : DesignModel
        Model that predicts the torque.
    home : (n,)
        Posture at the beginning and the end, rad or m.
    strokes : sequence of Stroke
        Strokes in the order in which they are made.
    repeats : int
        Number of times that each stroke is made there and back.
    rate : float
        Sampling rate, Hz.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    StrokeSequence
        The moves, and the part of them that identifies.

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
        # The stroke's speed takes the place of the velocity limit, so that the planner of moves reaches just that.
        limits[stroke.joint] = stroke.speed
        slow = replace(bounds, velocity=limits)
        low, high = home.copy(), home.copy()
        low[stroke.joint], high[stroke.joint] = stroke.low, stroke.high
        pieces.append(plan_path(posture, low, bounds, model, rate))
        for _ in range(repeats):
            pieces.append(move_within_torque(low, high, slow, model, rate))
            pieces.append(move_within_torque(high, low, slow, model, rate))
        posture = low
    last = sum(piece.duration for piece in pieces)
    # The way from home to the first stroke is not part of what identifies, nor is the way back, which is added below.
    first = pieces[0].duration
    pieces.append(plan_path(posture, home, bounds, model, rate))
    return StrokeSequence(tuple(pieces), first, last)
