"""Surfaces of links as triangles, for pictures of a robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.arrays import FloatArray

_FINEST = 96
"""Cells along the longest edge of a surface that the simplification begins with."""
_COARSER = 0.8
"""Factor by which the number of cells falls until few enough triangles are left."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles (k, 3), as indices of points (m, 3) in m."""

    points: FloatArray
    triangles: NDArray[np.intp]


def thin_surface(surface: Surface, most: int) -> Surface:
    """Return a surface with at most `most` triangles: all points in a cell of a grid become their mean.

    Rossignac and Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993.

    Parameters
    ----------
    surface : Surface
    most : int
        At least 12: the coarsest grid leaves no more than a box.
    """
    cells = float(_FINEST)
    coarser = surface
    while len(coarser.triangles) > most:
        coarser = _cluster_points(surface, cells)
        cells *= _COARSER
    return coarser


def _cluster_points(surface: Surface, cells: float) -> Surface:
    low = surface.points.min(axis=0)
    edge = max(float(np.ptp(surface.points, axis=0).max()) / cells, np.finfo(float).tiny)
    _, cell_of_point = np.unique(np.floor((surface.points - low) / edge).astype(np.int64), axis=0, return_inverse=True)
    cell_of_point = cell_of_point.reshape(-1)
    count = np.bincount(cell_of_point)
    means = np.column_stack([np.bincount(cell_of_point, weights=column) / count for column in surface.points.T])
    # Triangles whose corners fell into one cell are lines or points now; of equal ones the first remains.
    corners = cell_of_point[surface.triangles]
    a, b, c = corners.T
    whole = corners[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(whole, axis=1), axis=0, return_index=True)
    return Surface(means, whole[np.sort(first)])
