"""Postures that keep the limits: clear of everything, and held by less torque than there is."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError
from dynident.motion.limits.torque import TorqueModel
from dynident.robot.pointers import pointer

_POSTURES = 2000
# Room left for motion around a posture: of the torque, and of the position range.
_HOLDING_SHARE = 0.9
CENTRAL_SHARE = 0.8
# Of half the range: as good as zero.
_NEAR_ZERO = 1e-5
_TRIED_WAYS, _ENOUGH_WAYS = 200, 5
_ALONG_A_WAY = np.linspace(0.0, 1.0, 25)


def static_torque(model: TorqueModel, q: FloatArray) -> FloatArray:
    """Torque (m, n) that holds postures q (m, n)."""
    still = np.zeros_like(q)
    return model.torque(q, still, still)


def holdable_postures(bounds: Bounds, model: TorqueModel, rng: np.random.Generator) -> FloatArray:
    """Postures (m, n) in the inner part of the ranges, clear of everything, whose weight leaves room for motion.

    Those alone to which a straight way is clear from a usual home, if there are some: the rest may lie behind what no
    motion gets around, like an elbow bent the other way.

    Raises
    ------
    ImpossibleLimitsError
        None of many postures is clear, or can be held; the message names what would touch, or the joint whose torque
        limit is in the way.
    """
    places = CENTRAL_SHARE * rng.uniform(-1.0, 1.0, (_POSTURES, len(bounds.names)))
    q: FloatArray = _reachable(bounds, _clear_ones(bounds, bounds.middle + bounds.half_range * places))
    if not np.isfinite(bounds.torque).any():
        return q
    torque = np.abs(static_torque(model, q))
    shares = torque / bounds.torque
    worst = shares.max(axis=1)
    for share in (_HOLDING_SHARE, 1.0 - 1e-6):
        if (worst <= share).any():
            held: FloatArray = q[worst <= share]
            return held
    best = int(worst.argmin())
    joint = int(shares[best].argmax())
    name = bounds.names[joint]
    raise ImpossibleLimitsError(
        f"No posture can be held: in the easiest of {_POSTURES} the weight of the arm alone asks "
        f"{torque[best, joint]:.3g} of joint '{name}', whose torque limit is {bounds.torque[joint]:.3g}. Raise the "
        "limit, or widen the position limits to where the arm is easier to hold.",
        pointer=pointer(name, "effort", within="/limits"),
        title="Impossible limits",
    )


def usual_homes(bounds: Bounds) -> list[FloatArray]:
    """Zero where the ranges have it (their middle where not), and the middle everywhere: postures (n,)."""
    nearest = np.clip(0.0, bounds.position_low, bounds.position_high)
    return [np.where(np.abs(nearest) <= _NEAR_ZERO * bounds.half_range, nearest, bounds.middle), bounds.middle]


def _reachable(bounds: Bounds, q: FloatArray) -> FloatArray:
    """Of postures (m, n) some with a clear straight way from a usual home; all where hardly any has one."""
    if bounds.space is None or bounds.space.rooms is None:
        return q
    tried = q[:_TRIED_WAYS]
    for home in usual_homes(bounds):
        if bounds.space.least_room(home[None])[0] < 0:
            continue
        ways = home + _ALONG_A_WAY[:, None, None] * (tried - home)
        room = bounds.space.least_room(ways.reshape(-1, q.shape[1])).reshape(len(_ALONG_A_WAY), -1).min(axis=0)
        if np.count_nonzero(room >= 0) >= _ENOUGH_WAYS:
            reached: FloatArray = tried[room >= 0]
            return reached
    return q


def _clear_ones(bounds: Bounds, q: FloatArray) -> FloatArray:
    if bounds.space is None:
        return q
    room = bounds.space.least_room(q)
    if (room >= 0).any():
        clear: FloatArray = q[room >= 0]
        return clear
    best = q[int(room.argmax())]
    complaint = bounds.space.complaint(best[None]) or bounds.space.narrowness(best)
    raise ImpossibleLimitsError(
        f"In none of {_POSTURES} postures within the position limits is everything clear: in the best of them, "
        + complaint,
        pointer="/limits" if bounds.space.contacts is None and bounds.space.tool is None else "/surroundings",
        title="Impossible limits",
    )
