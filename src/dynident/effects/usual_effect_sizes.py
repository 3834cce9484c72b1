"""Usual sizes of effects by a joint's limits: speed and torque scales, friction and inertia as shares of them.

The shares follow the sources that the catalogue names for each effect, and recordings of real arms; they are not those
of any particular robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dynident.robot.robot_model import Robot

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
class UsualSize:
    """Usual size of an effect on a joint.

    Parameters
    ----------
    values : mapping of str to float
        Parameters by name, in their units; zero where not named.
    shape : mapping of str to float
        Shape constants by name, in their units; the default where not named.
    """

    values: Mapping[str, float]
    shape: Mapping[str, float] = field(default_factory=dict)


def get_velocity_scale(robot: Robot, joint: int) -> float:
    """Return the joint's velocity limit, or an arm's usual one; grids of velocities are relative to it.

    Parameters
    ----------
    robot : Robot
        The robot.
    joint : int
        Index of the joint.

    Returns
    -------
    float
        rad/s or m/s.
    """
    # A limit of zero or below, which some descriptions write for "none", would make a scale useless.
    limit = robot.joints[joint].limits.velocity
    return limit if limit is not None and limit > 0 else _VELOCITY_WHERE_UNKNOWN


def get_slowest_velocity(robot: Robot) -> float:
    """Return the smallest of the joints' velocity scales, which the width of a smooth sign is relative to."""
    return min(get_velocity_scale(robot, joint) for joint in range(robot.n))


def get_largest_torque(robot: Robot, joint: int) -> float:
    """Return the effort limit of a joint, or an arm's usual one where none is known.

    Parameters
    ----------
    robot : Robot
        The robot.
    joint : int
        Index of the joint.

    Returns
    -------
    float
        N m or N.
    """
    return robot.joints[joint].limits.effort or _EFFORT_WHERE_UNKNOWN


def get_usual_coulomb(robot: Robot, joint: int) -> float:
    """Return the usual Coulomb friction of a joint.

    Parameters
    ----------
    robot : Robot
        The robot.
    joint : int
        Index of the joint.

    Returns
    -------
    float
        N m or N.
    """
    return COULOMB_SHARE * get_largest_torque(robot, joint)


def get_usual_viscous(robot: Robot, joint: int) -> float:
    """Return the usual viscous friction of a joint.

    Parameters
    ----------
    robot : Robot
        The robot.
    joint : int
        Index of the joint.

    Returns
    -------
    float
        N m s/rad or N s/m.
    """
    return VISCOUS_SHARE * get_largest_torque(robot, joint) / get_velocity_scale(robot, joint)


def get_usual_force(robot: Robot) -> float:
    """Return the force (N) at one metre of a twelfth of the strongest joint's torque."""
    return max(get_largest_torque(robot, joint) for joint in range(robot.n)) / 12
