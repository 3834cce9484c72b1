"""Jerk-limited moves from rest to rest, by Ruckig (Berscheid and Kröger 2021), as polynomials evaluated in numpy.

Ruckig is used from state to state alone: its intermediate positions are computed by a service on the network, and its
position limits are silently ignored, so the extreme positions of every move are checked here. It knows no torque
limits: a move that breaks one is planned again, slower.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import ruckig

from dynident.excitation.feasible import static_torque
from dynident.excitation.limits import Bounds, ImpossibleLimitsError
from dynident.excitation.model import DesignModel
from dynident.excitation.motion import Motion, Piece, Rest
from dynident.robot.model import FloatArray

_SLOWER = 0.75
_ATTEMPTS = 16
_CHECKS = 400
_SAME_POSTURE = 1e-9


@dataclass(frozen=True, eq=False)
class Move:
    """Piecewise cubic positions: sections of joint j begin at `times[j]` (s,) with p, v, a (n, s) and jerk j (n, s)."""

    duration: float
    times: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray

    def range_of(self, joint: int) -> tuple[float, float]:
        """The ends of a joint's way, between which it stays but for rounding."""
        ends = self.position[joint, [0, -1]]
        return float(ends.min()), float(ends.max())

    def evaluate(self, t: FloatArray) -> Motion:
        """The motion at times t (m,)."""
        n = len(self.times)
        q, dq, ddq, dddq = (np.empty((len(t), n)) for _ in range(4))
        for j in range(n):
            section = np.searchsorted(self.times[j], t, side="right") - 1
            since = t - self.times[j, section]
            p, v, a, s = (values[j, section] for values in (self.position, self.velocity, self.acceleration, self.jerk))
            q[:, j] = np.clip(p + since * (v + since * (a / 2 + since * s / 6)), *self.range_of(j))
            dq[:, j] = v + since * (a + since * s / 2)
            ddq[:, j] = a + since * s
            dddq[:, j] = s
        return Motion(t, q, dq, ddq, dddq)


def plan_move(start: FloatArray, end: FloatArray, bounds: Bounds, rate: float, *, slowness: float = 1.0) -> Move | Rest:
    """The fastest straight move between two postures (n,) at rest that takes a whole number of sampling periods.

    Parameters
    ----------
    bounds : Bounds
        Velocity, acceleration, jerk and position are kept.
    rate : float
        Sampling rate in Hz.
    slowness : float
        The move is planned for a time this much longer.
    """
    if np.abs(end - start).max() < _SAME_POSTURE:
        return Rest(start)
    n = len(start)
    wanted = ruckig.InputParameter(n)
    wanted.current_position, wanted.target_position = start.tolist(), end.tolist()
    wanted.max_velocity = (bounds.velocity / slowness).tolist()
    wanted.max_acceleration = (bounds.acceleration / slowness**2).tolist()
    wanted.max_jerk = (bounds.jerk / slowness**3).tolist()
    wanted.synchronization = ruckig.Synchronization.Phase
    planner, planned = ruckig.Ruckig(n), ruckig.Trajectory(n)
    result = planner.calculate(wanted, planned)
    if result == ruckig.Result.Working:
        wanted.minimum_duration = math.ceil(planned.duration * rate - 1e-9) / rate
        result = planner.calculate(wanted, planned)
    if result != ruckig.Result.Working:
        raise ImpossibleLimitsError(f"no jerk-limited move between two postures was found ({result})")
    extrema = planned.position_extrema
    for j, name in enumerate(bounds.names):
        low, high = min(start[j], end[j]) - _SAME_POSTURE, max(start[j], end[j]) + _SAME_POSTURE
        if extrema[j].min < low or extrema[j].max > high:
            raise ImpossibleLimitsError(f"the move between two postures would swing joint '{name}' out of its way")
    return _as_move(planned, end)


def _as_move(planned: ruckig.Trajectory, end: FloatArray) -> Move:
    """Ruckig's profiles with a last section of rest, in arrays."""
    profiles = planned.profiles[0]
    times = np.array([np.concatenate([[0.0], np.cumsum(profile.t)]) for profile in profiles])
    position = np.array([profile.p for profile in profiles])
    position[:, -1] = end
    velocity, acceleration = (np.array([getattr(p, name) for p in profiles]) for name in ("v", "a"))
    velocity[:, -1] = acceleration[:, -1] = 0.0
    jerk = np.array([[*profile.j, 0.0] for profile in profiles])
    return Move(float(planned.duration), times, position, velocity, acceleration, jerk)


def move_within_torque(start: FloatArray, end: FloatArray, bounds: Bounds, model: DesignModel, rate: float) -> Piece:
    """A move as by `plan_move`, slowed down until the torque limits hold.

    Raises
    ------
    ImpossibleLimitsError
        The arm cannot be held somewhere on the way, however slow it goes.
    """
    move = plan_move(start, end, bounds, rate)
    if not bounds.checks_torque:
        return move
    _check_holding(start, end, bounds, model)
    for attempt in range(_ATTEMPTS):
        move = plan_move(start, end, bounds, rate, slowness=_SLOWER**-attempt)
        motion = move.evaluate(np.linspace(0.0, move.duration, _CHECKS))
        torque = model.torque(motion.q, motion.dq, motion.ddq)
        if (np.abs(torque) <= bounds.torque).all():
            return move
    raise _too_heavy(np.abs(torque), bounds, "moving slowly")


def _check_holding(start: FloatArray, end: FloatArray, bounds: Bounds, model: DesignModel) -> None:
    way = start + np.linspace(0.0, 1.0, _CHECKS)[:, None] * (end - start)
    torque = np.abs(static_torque(model, way))
    if not (torque <= bounds.torque).all():
        raise _too_heavy(torque, bounds, "holding the arm")


def _too_heavy(torque: FloatArray, bounds: Bounds, doing: str) -> ImpossibleLimitsError:
    shares = torque / bounds.torque
    sample, j = np.unravel_index(int(shares.argmax()), shares.shape)
    name = bounds.names[int(j)]
    return ImpossibleLimitsError(
        f"On the straight way between home and start, {doing} asks {torque[sample, j]:.4g} of joint '{name}', whose "
        f"torque limit is {bounds.torque[j]:.4g}; choose another home posture, or raise the limit.",
        pointer="/home",
        title="Impossible limits",
    )
