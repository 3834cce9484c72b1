"""Physics that the catalogue does not have, hidden all the same: the right answer is "unknown", and of what."""

from __future__ import annotations

import numpy as np
from engine import oddities

from hiding.case import Placed
from hiding.site import Family, Site


def friction_of_another_position(site: Site) -> Placed:
    j, other = (int(k) for k in site.rng.choice([0, 1, 3, 4], 2, replace=False))
    physics = oddities.FrictionOfAnotherPosition(j, other, site.sized(0.4, 0.6), 1.0)
    return Placed("friction_of_another_position", (j,), physics, variables=("other_joints",))


def rough_spot(site: Site) -> Placed:
    j = site.joint(turning=True)
    low, high = site.robot.joints[j].limits.position or (-3.0, 3.0)
    place = (low + high) / 2 + site.between(-0.5, 0.5)
    size = site.sized(0.02, 0.035) * float(site.effort[j])
    physics = oddities.RoughSpot(j, size, float(place), site.between(0.10, 0.20))
    return Placed("rough_spot", (j,), physics, equals=("torque_ripple",), variables=("position",))


def product_of_angles(site: Site) -> Placed:
    j, other = (int(k) for k in site.rng.choice([0, 1, 3, 4], 2, replace=False))
    physics = oddities.ProductOfAngles(j, other, site.sized(0.02, 0.035) * float(site.effort[j]))
    return Placed("product_of_angles", (j,), physics, variables=("other_joints", "position"))


def friction_of_acceleration(site: Site) -> Placed:
    j = site.joint()
    size = site.sized(0.35, 0.55) * float(site.drives.coulomb[j])
    physics = oddities.FrictionOfAcceleration(j, size, 0.1 * float(site.speed[j]))
    return Placed("friction_of_acceleration", (j,), physics, variables=("acceleration",))


def bursts(site: Site) -> Placed:
    j = site.joint()
    begins = np.sort(site.rng.uniform(0.1, 0.8, 2)) * site.length
    blocks = tuple((float(begin), float(begin) + site.between(1.0, 2.0)) for begin in begins)
    physics = oddities.Bursts(j, site.sized(0.02, 0.03) * float(site.effort[j]), blocks, int(site.rng.integers(1000)))
    return Placed("bursts", (j,), physics, equals=("external_contact",), variables=("time",))


def speed_notch(site: Site) -> Placed:
    j = site.joint()
    size, speed = site.sized(0.5, 0.8) * float(site.drives.coulomb[j]), float(site.speed[j])
    physics = oddities.SpeedNotch(j, size, site.between(0.15, 0.25) * speed, 0.05 * speed)
    return Placed("speed_notch", (j,), physics, equals=("stribeck", "viscous_nonlinear"), variables=("velocity",))


OUTSIDE: dict[str, Family] = {
    family.__name__: family
    for family in (
        friction_of_another_position, rough_spot, product_of_angles, friction_of_acceleration, bursts, speed_notch,
    )
}  # fmt: skip
