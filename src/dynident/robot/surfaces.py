"""Surfaces of links as triangles, as a picture of a robot wants them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.arrays import FloatArray

_FINEST = 96
"""Cells along the longest edge of a surface with which thinning begins."""
_COARSER = 0.8


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles (k, 3) between points (m, 3), as places in the list of points; m."""

    points: FloatArray
    triangles: NDArray[np.intp]


def thinned(surface: Surface, most: int) -> Surface:
    """The same with at most so many triangles: points of one cell of a grid become their mean.

    Rossignac and Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993.

    Parameters
    ----------
    surface : Surface
    most : int
        At least 12: what is left of the coarsest grid is no more than a box.
    """
    cells = float(_FINEST)
    found = surface
    while len(found.triangles) > most:
        found = _clustered(surface, cells)
        cells *= _COARSER
    return found


def _clustered(surface: Surface, cells: float) -> Surface:
    low = surface.points.min(axis=0)
    edge = max(float(np.ptp(surface.points, axis=0).max()) / cells, np.finfo(float).tiny)
    _, own = np.unique(np.floor((surface.points - low) / edge).astype(np.int64), axis=0, return_inverse=True)
    own = own.reshape(-1)
    count = np.bincount(own)
    means = np.column_stack([np.bincount(own, weights=column) / count for column in surface.points.T])
    corners = own[surface.triangles]
    a, b, c = corners.T
    whole = corners[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(whole, axis=1), axis=0, return_index=True)
    return Surface(means, whole[np.sort(first)])
