"""Motions in which some joints move while the others are locked (§12.3.4.2): which, and their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.arrays import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.motion.limits.bounds import Bounds
from dynident.robot.pointers import listed


def moving_joints(wanted: Sequence[str], names: Sequence[str]) -> BoolArray:
    """Which of the joints `names` (n,) move: the wanted ones, or all where none is named.

    Raises
    ------
    DynidentError
        There is no such joint.
    """
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise DynidentError(
            f"There is no joint {listed(unknown)}; joints: {listed(names)}.",
            pointer="/trajectory/joints",
            title="Unknown joint",
        )
    return np.array([not wanted or name in wanted for name in names])


def locked_bounds(bounds: Bounds, posture: FloatArray, moving: BoolArray) -> Bounds:
    """Bounds in which the joints that do not move have no range but their place in a posture (n,)."""
    return replace(
        bounds,
        position_low=np.where(moving, bounds.position_low, posture),
        position_high=np.where(moving, bounds.position_high, posture),
    )
