"""Limits of motions in which some joints move while the others are locked (§12.3.4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.arrays import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.motion.limits.bounds import Bounds
from dynident.robot.pointers import join_names


def select_moving_joints(selected: Sequence[str], names: Sequence[str]) -> BoolArray:
    """Return which of the joints `names` move.

    Parameters
    ----------
    selected : sequence of str
        Joints that move; all where there are none.
    names : sequence of str
        All n joints.

    Returns
    -------
    (n,) array of bool

    Raises
    ------
    DynidentError
        There is no such joint.
    """
    unknown = [name for name in selected if name not in names]
    if unknown:
        raise DynidentError(
            f"There is no joint {join_names(unknown)}; joints: {join_names(names)}.",
            pointer="/trajectory/joints",
            title="Unknown joint",
        )
    return np.array([not selected or name in selected for name in names])


def lock_bounds(bounds: Bounds, posture: FloatArray, moving: BoolArray) -> Bounds:
    """Return bounds in which the joints that do not move have no range but their position in a posture.

    Parameters
    ----------
    bounds : Bounds
    posture : (n,)
    moving : (n,)

    Returns
    -------
    Bounds
    """
    return replace(
        bounds,
        position_low=np.where(moving, bounds.position_low, posture),
        position_high=np.where(moving, bounds.position_high, posture),
    )
