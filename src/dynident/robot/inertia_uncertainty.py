"""Uncertainty of the inertias of a description, where nobody states a better one.

Masses, first moments and moments of inertia from drawings leave out bolts, cables and bearings (§12.1, ii): an error of
a fifth is usual. The error of a first moment is that share of the mass times the size of the link, and the error of a
moment of inertia that share of the mass times the size squared.
"""

from __future__ import annotations

import numpy as np

from dynident.array_types import FloatArray
from dynident.robot.model import Robot

# Usual relative error of a description.
DEFAULT_RELATIVE_ERROR = 0.2
# A link without mass in the description: relative error, assumed mass (kg); and the size of any link at least (m).
_SHARE_WITHOUT, _MASS, _SIZE = 1.0, 3.0, 0.15
# Rotor inertia for an effort limit of 1 N m, and where there is no limit (kg m²).
_ROTOR, _ROTOR_WHERE_UNKNOWN = 0.02, 1.0


def estimate_inertia_errors(robot: Robot, share: float = DEFAULT_RELATIVE_ERROR) -> FloatArray:
    """Return standard deviations of the description's standard inertial parameters.

    With the mass m of a link and l = 0.15 m + the distance of its centre of mass from the origin of the joint's frame,
    they are a share of m for the mass, of m l for first moments, and of m l² for moments of inertia. A link without
    mass in the description counts as one of 3 kg, with an error of all of it.

    Parameters
    ----------
    robot : Robot
        The robot.
    share : float
        Relative error of the description; a fifth by default.

    Returns
    -------
    ndarray (n, 10)
        In kg m², kg m and kg.
    """
    deviations = np.empty((robot.n, 10))
    for link in range(robot.n):
        # A link without a mass in the description still has one in truth: an arm's usual one, and all of it uncertain.
        mass, size, off = _MASS, _SIZE, _SHARE_WITHOUT
        if robot.inertias is not None and robot.inertias[link, 9] > 0:
            mass, off = float(robot.inertias[link, 9]), share
            size = _SIZE + float(np.linalg.norm(robot.inertias[link, 6:9])) / mass
        deviations[link] = off * mass * np.array([size**2] * 6 + [size] * 3 + [1.0])
    return deviations


def estimate_rotor_inertias(robot: Robot) -> FloatArray:
    """Return a plausible size (n,) of rotor inertias, seen at the joint, in kg m² or kg; no description has them."""
    limits = [joint.limits.effort for joint in robot.joints]
    return np.array([_ROTOR * limit if limit else _ROTOR_WHERE_UNKNOWN for limit in limits])
