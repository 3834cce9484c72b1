"""The pseudo-inertia of a link: a 4 x 4 matrix that is positive semidefinite for bodies that can exist.

With Σ = ∫ r rᵀ dm the second moments of the mass about the frame's origin, J = [[Σ, MS], [MSᵀ, M]] is the second moment
of the mass in homogeneous coordinates, so it is positive semidefinite where, and only where, some distribution of mass
that is nowhere negative has these ten parameters (Wensing, Kim and Slotine 2018): mass, moments of inertia and the
triangle inequality between them in one condition that is linear in the standard inertial parameters.
"""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.robot.model import INERTIAL_NAMES

_PLACES = {"X": 0, "Y": 1, "Z": 2}


def _basis() -> FloatArray:
    """(10, 4, 4): the pseudo-inertia of each inertial parameter, one of it and nothing else."""
    made = np.zeros((len(INERTIAL_NAMES), 4, 4))
    for k, name in enumerate(INERTIAL_NAMES):
        if name == "M":
            made[k, 3, 3] = 1.0
        elif name.startswith("M"):
            place = _PLACES[name[1]]
            made[k, place, 3] = made[k, 3, place] = 1.0
        else:
            first, second = (_PLACES[letter] for letter in name)
            # Σ = ½ tr(I) 1 - I for the inertia matrix I about the frame's origin.
            made[k, first, second] -= 1.0
            if first == second:
                made[k, :3, :3] += 0.5 * np.eye(3)
            else:
                made[k, second, first] -= 1.0
    return made


PSEUDO_INERTIA_PARTS: FloatArray = _basis()
"""(10, 4, 4): J = Σ parameter x part, in the order of `INERTIAL_NAMES`."""


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """(…, 4, 4): pseudo-inertia of inertial parameters (…, 10) about the joint frame's origin: kg m², kg m, kg."""
    return np.asarray(np.einsum("...k,kij->...ij", parameters, PSEUDO_INERTIA_PARTS))


def inertial_parameters(matrix: FloatArray) -> FloatArray:
    """(…, 10): inertial parameters in the order of `INERTIAL_NAMES` of pseudo-inertias (…, 4, 4)."""
    second = matrix[..., :3, :3]
    inertia = np.trace(second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - second
    found = []
    for name in INERTIAL_NAMES:
        if name == "M":
            found.append(matrix[..., 3, 3])
        elif name.startswith("M"):
            found.append(matrix[..., _PLACES[name[1]], 3])
        else:
            found.append(inertia[..., _PLACES[name[0]], _PLACES[name[1]]])
    return np.asarray(np.stack(found, axis=-1))


def smallest_pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """(…,): smallest eigenvalue of the pseudo-inertia of parameters (…, 10), without unit.

    The matrix is scaled to a unit diagonal, so that it does not depend on units or on the size of the link. Below zero:
    no body has these parameters. It is the smallest diagonal entry itself where one is not above zero, zero for a link
    without any mass.
    """
    matrices = pseudo_inertia(parameters)
    diagonal = np.diagonal(matrices, axis1=-2, axis2=-1)
    least = diagonal.min(axis=-1)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = matrices * scale[..., :, None] * scale[..., None, :]
    return np.asarray(np.where(least > 0, np.linalg.eigvalsh(scaled)[..., 0], least))
