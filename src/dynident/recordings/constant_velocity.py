"""Find rows in which one joint alone moves at nearly constant velocity: to identify its friction (§12.3.3)."""

from __future__ import annotations

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray

_SLOWEST = 5e-3
"""Speed in rad/s or m/s below which a joint may as well stick."""

_STILL = 2e-3
"""Speed in rad/s or m/s that filtered noise gives a joint at rest."""

_STILL_SHARE = 0.02
"""Share of the moving joint's speed that the others may have: a controller does not hold them perfectly."""

_DOUBLING = 0.25
"""Seconds in which the speed may double at the earliest: slower changes than that are nearly none."""


def find_sole_mover(dq: FloatArray, ddq: FloatArray) -> IntArray:
    """Return which joint alone moves at nearly constant velocity.

    Parameters
    ----------
    dq, ddq : (m, n)
        Filtered velocities (rad/s, m/s) and accelerations.

    Returns
    -------
    (m,) of int
        -1 if none does.
    """
    speed = np.abs(dq)
    first = np.argmax(speed, axis=1)
    rows = np.arange(len(speed))
    fastest = speed[rows, first]
    others = speed.copy()
    others[rows, first] = 0.0
    # A joint that is held shows noise at any speed, and gives way the more, the faster the other one moves. A robot of
    # one joint has no others: it counts as alone.
    alone = others.max(axis=1, initial=0.0) <= np.maximum(_STILL, _STILL_SHARE * fastest)
    # As a product: the acceleration of a joint at rest may be zero.
    steady = np.abs(ddq[rows, first]) * _DOUBLING <= fastest
    is_sole: BoolArray = alone & steady & (fastest >= _SLOWEST)
    return np.where(is_sole, first, -1).astype(np.int64)
