"""Pseudo-inertia of a link and its smallest eigenvalue; errors (20 %) and units of described inertias.

Holds the mass that is assumed of a link without one (3 kg).

With Σ = ∫ r rᵀ dm, the second moments of the mass about the frame's origin, J = [[Σ, MS], [MSᵀ, M]] is the second
moment of the mass in homogeneous coordinates. It is positive semidefinite if and only if some distribution of mass that
is nowhere negative has these ten parameters (Wensing, Kim and Slotine 2018). This one condition covers the mass, the
moments of inertia and the triangle inequality between them, and is linear in the standard inertial parameters.

Masses, first moments and moments of inertia from drawings leave out bolts, cables and bearings (§12.1, ii): an error of
a fifth is usual. The error of a first moment is that share of the mass times the size of the link, and the error of a
moment of inertia that share of the mass times the size squared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.robot.robot_model import INERTIAL_NAMES, Robot

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


_PLACES = {"X": 0, "Y": 1, "Z": 2}


def _build_basis() -> FloatArray:
    """Return the pseudo-inertias (10, 4, 4) of unit inertial parameters, one parameter each."""
    basis = np.zeros((len(INERTIAL_NAMES), 4, 4))
    for k, name in enumerate(INERTIAL_NAMES):
        if name == "M":
            basis[k, 3, 3] = 1.0
        elif name.startswith("M"):
            place = _PLACES[name[1]]
            basis[k, place, 3] = basis[k, 3, place] = 1.0
        else:
            first, second = (_PLACES[letter] for letter in name)
            # Σ = ½ tr(I) 1 - I for the inertia matrix I about the frame's origin.
            basis[k, first, second] -= 1.0
            if first == second:
                basis[k, :3, :3] += 0.5 * np.eye(3)
            else:
                basis[k, second, first] -= 1.0
    return basis


PSEUDO_INERTIA_PARTS: FloatArray = _build_basis()
"""(10, 4, 4): J = Σ parameter x part, in the order of `INERTIAL_NAMES`."""


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """Return the pseudo-inertia of inertial parameters.

    Parameters
    ----------
    parameters : ndarray (…, 10)
        In the order of `INERTIAL_NAMES`, about the origin of the joint's frame.

    Returns
    -------
    ndarray (…, 4, 4)
        In kg m², kg m and kg.
    """
    return np.asarray(np.einsum("...k,kij->...ij", parameters, PSEUDO_INERTIA_PARTS))


def inertial_parameters(matrix: FloatArray) -> FloatArray:
    """Return the inertial parameters (…, 10), in the order of `INERTIAL_NAMES`, of pseudo-inertias (…, 4, 4)."""
    # The inverse of Σ = ½ tr(I) 1 - I is I = tr(Σ) 1 - Σ.
    second = matrix[..., :3, :3]
    inertia = np.trace(second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - second
    parameters = []
    for name in INERTIAL_NAMES:
        if name == "M":
            parameters.append(matrix[..., 3, 3])
        elif name.startswith("M"):
            parameters.append(matrix[..., _PLACES[name[1]], 3])
        else:
            parameters.append(inertia[..., _PLACES[name[0]], _PLACES[name[1]]])
    return np.asarray(np.stack(parameters, axis=-1))


def smallest_pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """Return the smallest eigenvalue of the scaled pseudo-inertia; below zero, no body has these parameters.

    The matrix is scaled to a unit diagonal, so that the result depends neither on units nor on the size of the link.

    Parameters
    ----------
    parameters : ndarray (…, 10)
        In the order of `INERTIAL_NAMES`, about the origin of the joint's frame.

    Returns
    -------
    ndarray (…,)
        Without unit. Where a diagonal entry is not positive, the smallest diagonal entry itself: zero for a link
        without any mass.
    """
    matrices = pseudo_inertia(parameters)
    diagonal = np.diagonal(matrices, axis1=-2, axis2=-1)
    least = diagonal.min(axis=-1)
    # Scaling rows and columns alike changes the sizes of eigenvalues, but none of their signs (Sylvester).
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = matrices * scale[..., :, None] * scale[..., None, :]
    return np.asarray(np.where(least > 0, np.linalg.eigvalsh(scaled)[..., 0], least))


_IMPOSSIBLE = 0.01
"""How far below zero rounded drawings may bring an eigenvalue of a pseudo-inertia, scaled to a unit diagonal."""


def find_impossible_links(robot: Robot) -> list[str]:
    """Return the links of a robot, by their joints, whose described inertia no body can have."""
    if robot.inertias is None:
        return []
    # A body exists where its pseudo-inertia has no negative eigenvalue.
    smallest = smallest_pseudo_inertia(robot.inertias)
    return [name for name, least in zip(robot.tree.joint_names, smallest, strict=False) if least < -_IMPOSSIBLE]


_HEAVIEST, _LIGHTEST = 1000.0, 200.0
"""kg per m² of reach between the joints: arms have 2 to 160, from a hobby servo arm to one for 300 kg, and in grams at
least 2,000; and grams of the lightest robot: compact machines such as pan-tilt heads have fewer kg."""

_WIDEST = 3.0
"""Times the reach between the joints up to which a link's centre of mass, or its radius of gyration, may be from its
joint: 0.6 in descriptions that are right, and 30 and more with mm taken for m."""

_LONGEST_END, _SHORTEST = 3.0, 0.1
"""Distance in m of a centre of mass from its joint above which it is in mm; and reach between the joints below which it
does not say how large the robot is."""

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


def measure_reach(robot: Robot) -> float:
    """Return the length in m of the robot from its base, all links stretched.

    Parameters
    ----------
    robot : Robot
        The robot.
    """
    reach = sum(float(np.linalg.norm(np.asarray(joint.placement)[:3, 3])) for joint in robot.joints)
    if robot.inertias is None:
        return reach
    # No joint says how long a pendulum is: as long as its centre of mass is far, in m.
    ends = np.isin(np.arange(len(robot.inertias)), [joint.parent for joint in robot.tree.joints], invert=True)
    links = robot.inertias[ends & (robot.inertias[:, 9] > 0.0)]
    centres = np.linalg.norm(links[:, 6:9], axis=1) / links[:, 9]
    return max(reach, float(centres[centres < _LONGEST_END].sum()))


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
    # Neither a pedestal nor the centre of mass of a balanced wheel says how large a robot is.
    places = [np.asarray(joint.placement)[:3, 3] for joint in robot.joints if joint.parent >= 0]
    reach = float(np.linalg.norm(places, axis=-1).sum())
    links = robot.inertias[robot.inertias[:, 9] > 0]
    masses = links[:, 9]
    # Without a length nothing can be compared.
    if reach < _SHORTEST:
        return None
    mass = _SMALL if masses.sum() > max(_LIGHTEST, _HEAVIEST * reach**2) else 1.0
    # The median over the links: a single link may have an odd centre of mass, a unit is wrong for all of them.
    centre = float(np.median(np.linalg.norm(links[:, 6:9], axis=1) / masses))
    moment = mass * (_SMALL if centre > _WIDEST * reach else 1.0)
    # Radius of gyration about the joint, by the largest moment of inertia; about the centre of mass it is no larger.
    squares = np.abs(links[:, [0, 3, 5]]).max(axis=1) / masses
    wide = float(np.sqrt(np.median(squares))) > _WIDEST * reach
    units = DescriptionUnits(mass, moment, mass * (_SMALL**2 if wide else 1.0))
    return None if units == DescriptionUnits(1.0, 1.0, 1.0) else units
