"""What every arm has: rotors and friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.robot import Robot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drives:
    """Rotor inertia, Coulomb and viscous friction of every joint, each (n,)."""

    rotor: FloatArray
    coulomb: FloatArray
    viscous: FloatArray


def effort_limits(robot: Robot) -> FloatArray:
    """(n,) in N m or N."""
    return np.array([joint.limits.effort for joint in robot.joints], dtype=np.float64)


def speed_limits(robot: Robot) -> FloatArray:
    """(n,) in rad/s or m/s."""
    return np.array([joint.limits.velocity for joint in robot.joints], dtype=np.float64)


def usual_drives(robot: Robot) -> Drives:
    """Drives of the size that geared arms have: Coulomb 3 %, viscous 5 % of the effort limit at full speed."""
    effort = effort_limits(robot)
    return Drives(rotor=0.006 * effort, coulomb=0.03 * effort, viscous=0.05 * effort / speed_limits(robot))
