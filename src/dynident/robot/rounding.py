"""Mend constants that were rounded when a description was written.

A URDF writes a right angle as 1.57079632679, whose cosine is 5e-12 where 0 was meant. Such entries cost instructions in
every symbolic expression and add parameters that no measurement could see. Entries within `ROUNDING_TOLERANCE` of 0,
±1/2 and ±1 are therefore set to them. The default moves nothing by more than 1e-10, so results stay those of Pinocchio
to ten digits. Angles written with fewer digits (1.5708) are left as they stand unless the caller raises the tolerance
(1e-5 mends 1.5708).
"""

from __future__ import annotations

import numpy as np

from dynident.array_types import FloatArray

ROUNDING_TOLERANCE = 1e-10
_EXACT = np.array([0.0, 0.5, -0.5, 1.0, -1.0])


def mend_placement(placement: FloatArray, tolerance: float = ROUNDING_TOLERANCE) -> FloatArray:
    """Return the homogeneous transform (4, 4) with rounded constants mended and a rotation that is still orthonormal.

    Distances are only compared with zero: any other length is as good as 1/2 or 1.

    Parameters
    ----------
    placement : (4, 4)
        A homogeneous transform, m.
    tolerance : float
        Entries this near to 0, ±1/2 and ±1 become these.

    Returns
    -------
    (4, 4) array
        The mended transform.
    """
    mended = np.eye(4)
    mended[:3, :3] = _orthonormalize(_snap(placement[:3, :3], tolerance))
    mended[:3, 3] = np.where(np.abs(placement[:3, 3]) <= tolerance, 0.0, placement[:3, 3])
    return mended


def mend_axis(axis: FloatArray, tolerance: float = ROUNDING_TOLERANCE) -> FloatArray:
    """Return a direction with rounded constants mended, of unit length.

    Parameters
    ----------
    axis : (3,)
        A direction of any length but zero.
    tolerance : float
        Entries of the unit vector this near to 0, ±1/2 and ±1 become these.

    Returns
    -------
    (3,) array
        A unit vector.
    """
    unit = _snap(axis / np.linalg.norm(axis), tolerance)
    mended: FloatArray = unit / np.linalg.norm(unit)
    return mended


def _snap(values: FloatArray, tolerance: float) -> FloatArray:
    snapped = values.copy()
    for exact in _EXACT:
        snapped[np.abs(values - exact) <= tolerance] = exact
    return snapped


def _orthonormalize(rotation: FloatArray) -> FloatArray:
    """Return the nearest rotation by two Newton steps: each squares the error, and exact zeros and ones stay."""
    for _ in range(2):
        rotation = rotation - 0.5 * rotation @ (rotation.T @ rotation - np.eye(3))
    # The steps themselves round: an entry that was exactly 1 may have become 1 - eps.
    return _snap(rotation, 4 * np.finfo(float).eps)
