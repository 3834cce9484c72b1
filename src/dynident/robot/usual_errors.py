"""How far the inertias of a description are usually off: what they are believed as well as, where nobody says better.

Masses, first moments and moments of inertia from drawings leave out bolts, cables and bearings (§12.1, ii): a fifth is
usual. A first moment is off by so much of the mass at a distance of the link's size, and a moment of inertia by so much
of the mass at its square.
"""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.robot.model import Robot

# How far a description is usually off, as a share; and a link where it says nothing (kg, m).
USUAL_SHARE, _SHARE_WITHOUT, _MASS, _SIZE = 0.2, 1.0, 3.0, 0.15
# Rotor inertia for an effort limit of 1 N m, and where there is no limit (kg m²).
_ROTOR, _ROTOR_WHERE_UNKNOWN = 0.02, 1.0


def usual_errors(robot: Robot, share: float = USUAL_SHARE) -> FloatArray:
    """(n, 10): standard deviations of the description's standard inertial parameters: kg m², kg m, kg.

    With m the mass of the link and l = 0.15 m + the distance of its centre of mass from the joint frame's origin: a
    share of m for the mass, of m l for the first moments, of m l² for the moments of inertia; a fifth where nobody says
    better. A link without mass in the description counts as one of 3 kg, off by all of it.
    """
    made = np.empty((robot.n, 10))
    for link in range(robot.n):
        mass, size, off = _MASS, _SIZE, _SHARE_WITHOUT
        if robot.inertias is not None and robot.inertias[link, 9] > 0:
            mass, off = float(robot.inertias[link, 9]), share
            size = _SIZE + float(np.linalg.norm(robot.inertias[link, 6:9])) / mass
        made[link] = off * mass * np.array([size**2] * 6 + [size] * 3 + [1.0])
    return made


def usual_rotor_inertias(robot: Robot) -> FloatArray:
    """(n,): size that rotor inertias, seen at the joint, may well have; no description gives them. kg m² or kg."""
    limits = [joint.limits.effort for joint in robot.joints]
    return np.array([_ROTOR * limit if limit else _ROTOR_WHERE_UNKNOWN for limit in limits])
