"""What is usual of the joints of real arms: their torque, their speed, and the shares of it that effects take.

Shares of a joint's largest torque, after the sources that the catalogue names for each effect and recordings of real
arms: not those of any particular robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dynident.robot.model import Robot

# Where a description gives no velocity limit: the order of magnitude of an arm's joints, rad/s or m/s.
_VELOCITY_WHERE_UNKNOWN = 2.0
# Where a description gives no effort limit, N m or N.
_EFFORT_WHERE_UNKNOWN = 50.0

COULOMB_SHARE = 0.03
"""Coulomb friction per unit of a joint's largest torque."""
VISCOUS_SHARE = 0.05
"""Viscous friction at full speed per unit of a joint's largest torque."""
ROTOR_SHARE = 0.006
"""Rotor inertia per unit of the largest torque, kg m² per N m: a geared servo drive reaches about 170 rad/s² alone."""


@dataclass(frozen=True)
class Usual:
    """How large an effect is where an arm has it: parameters and shape constants by name, zero or default otherwise."""

    values: Mapping[str, float]
    shape: Mapping[str, float] = field(default_factory=dict)


def velocity_scale(robot: Robot, joint: int) -> float:
    """The joint's velocity limit, or an arm's usual one: what grids of velocities are relative to."""
    limit = robot.joints[joint].limits.velocity
    return limit if limit is not None and limit > 0 else _VELOCITY_WHERE_UNKNOWN


def slowest_velocity(robot: Robot) -> float:
    """The smallest of the joints' velocity scales: what the width of a smooth sign of friction is measured by."""
    return min(velocity_scale(robot, joint) for joint in range(robot.n))


def largest_torque(robot: Robot, joint: int) -> float:
    """The effort limit of a joint, or an arm's usual one where none is known (N m or N)."""
    return robot.joints[joint].limits.effort or _EFFORT_WHERE_UNKNOWN


def usual_coulomb(robot: Robot, joint: int) -> float:
    """Coulomb friction of a joint (N m or N)."""
    return COULOMB_SHARE * largest_torque(robot, joint)


def usual_viscous(robot: Robot, joint: int) -> float:
    """Viscous friction of a joint (N m s/rad or N s/m)."""
    return VISCOUS_SHARE * largest_torque(robot, joint) / velocity_scale(robot, joint)


def usual_force(robot: Robot) -> float:
    """What the strongest joint lifts at one metre with a twelfth of its torque (N)."""
    return max(largest_torque(robot, joint) for joint in range(robot.n)) / 12
