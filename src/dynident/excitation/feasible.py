"""Motions that keep the limits: postures that can be held, and how far a trajectory must shrink until it fits."""

from __future__ import annotations

import numpy as np

from dynident.excitation.family import Family
from dynident.excitation.limits import Bounds, ImpossibleLimitsError
from dynident.excitation.model import DesignModel
from dynident.robot.model import FloatArray
from dynident.robot.pointers import pointer

_POSTURES = 2000
# Room left for motion around a posture: of the torque, and of the position range.
_HOLDING_SHARE = 0.9
_CENTRAL_SHARE = 0.8
_BISECTIONS = 12
# Of half the range: as good as zero.
_NEAR_ZERO = 1e-5
_TRIED_WAYS, _ENOUGH_WAYS = 200, 5
_ALONG_A_WAY = np.linspace(0.0, 1.0, 25)
_SAMPLES_PER_WAVE = 80


def static_torque(model: DesignModel, q: FloatArray) -> FloatArray:
    """Torque (m, n) that holds postures q (m, n)."""
    still = np.zeros_like(q)
    return model.torque(q, still, still)


def holdable_postures(bounds: Bounds, model: DesignModel, rng: np.random.Generator) -> FloatArray:
    """Postures (m, n) in the inner part of the ranges, clear of everything, whose weight leaves room for motion.

    Those alone to which a straight way is clear from a usual home, if there are some: the rest may lie behind what no
    motion gets around, like an elbow bent the other way.

    Raises
    ------
    ImpossibleLimitsError
        None of many postures is clear, or can be held; the message names what would touch, or the joint whose torque
        limit is in the way.
    """
    places = _CENTRAL_SHARE * rng.uniform(-1.0, 1.0, (_POSTURES, len(bounds.names)))
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
    if bounds.space is None or bounds.space.clearances is None:
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
        pointer="/surroundings",
        title="Impossible limits",
    )


class Shrinking:
    """Takes the coefficients of a family to the largest amplitude at which they keep the limits."""

    def __init__(self, family: Family, bounds: Bounds, model: DesignModel, *, fine: bool = True) -> None:
        self._bounds, self._model = bounds, model
        count = _SAMPLES_PER_WAVE * family.waves if fine else 2 * _SAMPLES_PER_WAVE
        self._basis = family.basis(np.arange(count) * family.period / count)[:4]

    def shrink(self, x: FloatArray, most: float = 1.0) -> FloatArray | None:
        """Coefficients (m, n) with the amplitude scaled by at most `most`; `None` where even its centre cannot be held.

        The centre (the offsets) stays, except that it is moved inside the position limits.
        """
        b = self._bounds
        made = x.copy()
        made[0] = np.clip(x[0], b.middle - _CENTRAL_SHARE * b.half_range, b.middle + _CENTRAL_SHARE * b.half_range)
        inside = (b.position_low < x[0]) & (x[0] < b.position_high)
        made[0, inside] = x[0, inside]
        q, dq, ddq, dddq = self._basis[:, :, 1:] @ made[1:]
        # A joint that is locked has neither room nor motion: 0 / 0.
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = min(
                most,
                float(np.nanmin((b.position_high - made[0]) / np.maximum(q.max(axis=0), 0.0))),
                float(np.nanmin((made[0] - b.position_low) / np.maximum(-q.min(axis=0), 0.0))),
                float((b.velocity / np.abs(dq).max(axis=0)).min()),
                float((b.acceleration / np.abs(ddq).max(axis=0)).min()),
                float((b.jerk / np.abs(dddq).max(axis=0)).min()),
            )
        found = self._within_the_rest(made[0], q, dq, ddq, scale)
        if found is None:
            return None
        made[1:] *= found
        return made

    def _within_the_rest(
        self, centre: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, most: float
    ) -> float | None:
        """The largest amplitude up to `most` at which torque, power and clearances are kept, by bisection."""
        bounds = self._bounds
        if not bounds.checks_torque and bounds.space is None:
            return most

        def holds(scale: float) -> bool:
            # Bodies scaled in amplitude by s at unchanged frequency: q̇ and q̈ scale alike.
            at, speed = centre + scale * q, scale * dq
            if bounds.checks_torque:
                torque = self._model.torque(at, speed, scale * ddq)
                if not ((np.abs(torque) <= bounds.torque) & (np.abs(torque * speed) <= bounds.power)).all():
                    return False
            return bounds.space is None or bool((bounds.space.least_room(at) >= 0).all())

        if holds(most):
            return most
        if not holds(0.0):
            return None
        low, high = 0.0, most
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if holds(middle) else (low, middle)
        return low or None
