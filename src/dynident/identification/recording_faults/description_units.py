"""Find the units of a description's masses, lengths and inertias (kg, g, mm) from its own numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.robot.robot_model import Robot

_HEAVIEST = 1000.0
"""kg per m² of reach: arms have 10 to 160, from a hobby servo arm to one for 300 kg; in grams it is at least 10,000."""

_WIDEST = 3.0
"""Times the reach up to which a link's centre of mass, or its radius of gyration, may be from its joint: 0.6 in
descriptions that are right, and 30 and more with mm taken for m."""

_SMALL = 1e-3


@dataclass(frozen=True)
class DescriptionUnits:
    """Factors that bring a description's numbers to SI units.

    Parameters
    ----------
    mass : float
        Factor of the masses.
    moment : float
        Factor of the first moments.
    inertia : float
        Factor of the moments and products of inertia.
    """

    mass: float
    moment: float
    inertia: float

    def to_si(self, robot: Robot) -> Robot:
        """Return the robot with inertial parameters in SI units.

        Parameters
        ----------
        robot : Robot
            As it was described.
        """
        assert robot.inertias is not None
        factors = np.array([self.inertia] * 6 + [self.moment] * 3 + [self.mass])
        return replace(robot, inertias=robot.inertias * factors)

    def __str__(self) -> str:
        masses = "" if self.mass == 1.0 else "masses seem to be in g, 1000 times the mass of such an arm"
        centres = "" if self.moment == self.mass else "centres of mass seem to be in mm"
        times = self.inertia / self.mass
        unit = {(_SMALL, _SMALL**2): "g mm²", (1.0, _SMALL**2): "kg mm²", (_SMALL, 1.0): "g m²"}
        named = unit.get((self.mass, round(times, 12)))
        inertias = "" if self.inertia == 1.0 else f"inertias in {named}, {1.0 / self.inertia:.0e} times those in kg m²"
        return ", ".join(text for text in (masses, centres, inertias) if text)


def find_description_units(robot: Robot) -> DescriptionUnits | None:
    """Find the units of a description's masses, from its own numbers alone.

    Parameters
    ----------
    robot : Robot
        The robot.

    Returns
    -------
    DescriptionUnits or None
        None where they are SI, or the description has no masses.
    """
    if robot.inertias is None or not np.any(robot.inertias[:, 9] > 0):
        return None
    reach = sum(float(np.linalg.norm(np.asarray(joint.placement)[:3, 3])) for joint in robot.joints)
    links = robot.inertias[robot.inertias[:, 9] > 0]
    # Without a length nothing can be compared.
    if reach <= 0.0:
        return None
    masses = links[:, 9]
    mass = _SMALL if masses.sum() > _HEAVIEST * reach**2 else 1.0
    # The median over the links: a single link may have an odd centre of mass, a unit is wrong for all of them.
    centre = float(np.median(np.linalg.norm(links[:, 6:9], axis=1) / masses))
    moment = mass * (_SMALL if centre > _WIDEST * reach else 1.0)
    # Radius of gyration about the joint, by the largest moment of inertia; about the centre of mass it is no larger.
    squares = np.abs(links[:, [0, 3, 5]]).max(axis=1) / masses
    wide = float(np.sqrt(np.median(squares))) > _WIDEST * reach
    units = DescriptionUnits(mass, moment, mass * (_SMALL**2 if wide else 1.0))
    return None if units == DescriptionUnits(1.0, 1.0, 1.0) else units
