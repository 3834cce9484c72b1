"""Jerk-limited moves from rest to rest (by Ruckig), slowed down until torque limits hold.

Ruckig plans the covered share of a straight path between two states only: its intermediate positions are
computed by a network service, and its position limits are silently ignored, so extreme positions are checked
here. It knows no torque limits: a move that breaks one is planned again, slower.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import ruckig

from dynident.array_types import FloatArray
from dynident.motion.joint_trajectories import Motion, Piece, Rest, check_length
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, TorqueModel
from dynident.motion.limits.postures_within_limits import compute_static_torque

# Speed of each attempt over the one before, and number of attempts: the last one takes 75 times as long as the first.
_SLOWER = 0.75
_ATTEMPTS = 16
# Least number of samples at which a move is checked.
_CHECKS = 400
_CHECKS_PER_SAMPLE = 10
# Distance of two postures (rad, m) that counts as none, and share of the way that a move may exceed by rounding.
_SAME_POSTURE = 1e-9
_OVERSHOOT = 1e-9


@dataclass(frozen=True, eq=False)
class Move:
    """A straight move: q(t) = start + s(t) (end - start), s from 0 to 1 piecewise cubic, then rest up to `duration`.

    Parameters
    ----------
    start, end : (n,)
        Postures at the ends, rad or m.
    duration : float
        Duration, s.
    times : (sections,)
        Time at which each section begins, s.
    place : (sections, 4)
        s and its first three derivatives at the beginning of each section.
    """

    start: FloatArray
    end: FloatArray
    duration: float
    times: FloatArray
    place: FloatArray

    def evaluate(self, t: FloatArray) -> Motion:
        """Return the motion at times t (m,)."""
        section = np.searchsorted(self.times, t, side="right") - 1
        since = t - self.times[section]
        s, v, a, j = self.place[section].T
        way = self.end - self.start
        # Rounding must not carry the arm beyond its ends, which may touch a limit.
        share = np.clip(s + since * (v + since * (a / 2 + since * j / 6)), 0.0, 1.0)
        return Motion(
            t=t,
            q=np.where(share[:, None] < 1.0, self.start + np.outer(share, way), self.end),
            dq=np.outer(v + since * (a + since * j / 2), way),
            ddq=np.outer(a + since * j, way),
            dddq=np.outer(j, way),
        )


def plan_move(start: FloatArray, end: FloatArray, bounds: Bounds, rate: float, *, slowness: float = 1.0) -> Move | Rest:
    """Plan the fastest straight move between two postures at rest.

    Its duration is rounded up to a whole number of sampling periods.

    Parameters
    ----------
    start, end : (n,)
        Postures at the ends, rad or m.
    bounds : Bounds
        Velocity, acceleration and jerk are kept; a straight move between postures inside the position limits keeps
        those as well.
    rate : float
        Sampling rate, Hz.
    slowness : float
        The move is planned to take this many times as long.

    Returns
    -------
    Move or Rest
        The move; Rest where the postures are the same.

    Raises
    ------
    ImpossibleLimitsError
        No such move was found.
    """
    way = np.abs(end - start)
    if way.max() < _SAME_POSTURE:
        return Rest(start)
    limits = ruckig.InputParameter(1)
    limits.current_position, limits.target_position = [0.0], [1.0]
    with np.errstate(divide="ignore"):
        # All joints share s: the slowest one decides. Time scaling by f scales velocity, acceleration and jerk by 1/f,
        # 1/f², 1/f³.
        limits.max_velocity = [float((bounds.velocity / way).min()) / slowness]
        limits.max_acceleration = [float((bounds.acceleration / way).min()) / slowness**2]
        limits.max_jerk = [float((bounds.jerk / way).min()) / slowness**3]
    planned = ruckig.Trajectory(1)
    # One degree of freedom, the share s of the path: all joints then move along a straight line.
    result = ruckig.Ruckig(1).calculate(limits, planned)
    if result != ruckig.Result.Working:
        raise ImpossibleLimitsError(f"no jerk-limited move between two postures was found ({result})")
    extrema = planned.position_extrema[0]
    if extrema.min < -_OVERSHOOT or extrema.max > 1 + _OVERSHOOT:
        raise ImpossibleLimitsError("the move between two postures would overshoot its ends")
    profile = planned.profiles[0][0]
    sections = np.column_stack([profile.p, profile.v, profile.a, [*profile.j, 0.0]])
    # The last section is rest at the end, exactly; the profile itself ends there but for rounding.
    sections[-1] = (1.0, 0.0, 0.0, 0.0)
    return Move(
        start=start,
        end=end,
        # The small number keeps a duration that is whole but for rounding from becoming one period longer.
        duration=math.ceil(planned.duration * rate - 1e-9) / rate,
        times=np.concatenate([[0.0], np.cumsum(profile.t)]),
        place=sections,
    )


def move_within_torque(start: FloatArray, end: FloatArray, bounds: Bounds, model: TorqueModel, rate: float) -> Piece:
    """Plan a move that keeps the limits of torque, power and follower joints as well, slower where they need it.

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
    Move or Rest
        The move; Rest where the postures are the same.

    Raises
    ------
    ImpossibleLimitsError
        Something is in the straight path, or the arm cannot be held somewhere on it, however slow it goes.
    """
    complaint = find_straight_obstacle(start, end, bounds)
    if complaint is not None:
        raise complaint
    move = plan_move(start, end, bounds, rate)
    if not bounds.has_torque_limits and bounds.follower_rates is None and bounds.balance is None:
        return move
    if bounds.has_torque_limits:
        # However slow the move, the weight remains: check it first, to report it as such.
        _check_holding(start, end, bounds, model)
    for attempt in range(_ATTEMPTS):
        move = plan_move(start, end, bounds, rate, slowness=_SLOWER**-attempt)
        check_length([move], rate)
        # The times at which the design is verified in the end, and of a short move times between them: so a move that
        # passes here passes there.
        steps = int(np.ceil(_CHECKS_PER_SAMPLE * rate * move.duration))
        steps *= int(np.ceil(_CHECKS / max(steps, 1)))
        motion = move.evaluate(np.linspace(0.0, move.duration, steps + 1))
        slow_enough = bounds.are_rates_and_balance_kept(motion.q, motion.dq, motion.ddq)
        if slow_enough and _is_within_torque(motion, bounds, model):
            return move
    # After the last attempt: what is still too fast then does not get slower with the move.
    if not slow_enough and bounds.balance is not None:
        raise ImpossibleLimitsError(
            f"On the straight path from [{_format_posture(start)}] to [{_format_posture(end)}], the robot does not "
            "keep its balance at any speed; choose another home posture, or a smaller margin.",
            pointer="/standing",
            title="Impossible limits",
        )
    if not slow_enough:
        names = "" if bounds.follower_rates is None else ", ".join(bounds.follower_rates.names)
        raise ImpossibleLimitsError(
            f"On the straight path from [{_format_posture(start)}] to [{_format_posture(end)}], joints that follow "
            f"others ({names}) would exceed their limits of velocity and acceleration at any speed; raise these "
            "limits, or choose another home posture.",
            pointer="/limits",
            title="Impossible limits",
        )
    raise _build_torque_error(np.abs(model.torque(motion.q, motion.dq, motion.ddq)), bounds, "moving slowly")


def _is_within_torque(motion: Motion, bounds: Bounds, model: TorqueModel) -> bool:
    if not bounds.has_torque_limits:
        return True
    torque = model.torque(motion.q, motion.dq, motion.ddq)
    return bool((np.abs(torque) <= bounds.torque).all() and (np.abs(torque * motion.dq) <= bounds.power).all())


def find_straight_obstacle(start: FloatArray, end: FloatArray, bounds: Bounds) -> ImpossibleLimitsError | None:
    """Return the error that names what is in the straight path between two postures (n,); None where it is clear.

    Parameters
    ----------
    start, end : (n,)
        Postures at the ends, rad or m.
    bounds : Bounds
        Limits of the motion.
    """
    if bounds.space is None:
        return None
    way = start + np.linspace(0.0, 1.0, _CHECKS)[:, None] * (end - start)
    complaint = bounds.space.find_complaint(way)
    if complaint is None:
        return None
    return ImpossibleLimitsError(
        f"On the straight path from [{_format_posture(start)}] to [{_format_posture(end)}], {complaint}",
        pointer="/home",
        title="Impossible limits",
    )


def _format_posture(posture: FloatArray) -> str:
    return ", ".join(f"{value:.4g}" for value in posture)


def _check_holding(start: FloatArray, end: FloatArray, bounds: Bounds, model: TorqueModel) -> None:
    way = start + np.linspace(0.0, 1.0, _CHECKS)[:, None] * (end - start)
    torque = np.abs(compute_static_torque(model, way))
    if not (torque <= bounds.torque).all():
        raise _build_torque_error(torque, bounds, "holding the arm")


def _build_torque_error(torque: FloatArray, bounds: Bounds, doing: str) -> ImpossibleLimitsError:
    shares = torque / bounds.torque
    sample, j = np.unravel_index(int(shares.argmax()), shares.shape)
    name = bounds.names[int(j)]
    return ImpossibleLimitsError(
        f"On the straight path between home and start, {doing} needs {torque[sample, j]:.4g} from joint '{name}', "
        f"whose torque limit is {bounds.torque[j]:.4g}; choose another home posture, or raise the limit.",
        pointer="/home",
        title="Impossible limits",
    )
