"""Surfaces of links as triangles: read them from mesh files, simplify them, enclose them by a few convex pieces."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from dynident.array_types import FloatArray
from dynident.robot.mesh_readers import read_triangles
from dynident.robot.shapes import Block, Hull, enclose_points

_FINEST = 96
"""Cells along the longest edge of a surface that the simplification begins with."""
_COARSER = 0.8
"""Factor by which the number of cells falls until few enough triangles are left."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface of triangles.

    Parameters
    ----------
    points : (m, 3)
        Corners, m.
    triangles : (k, 3)
        Indices of corners.
    """

    points: FloatArray
    triangles: NDArray[np.intp]


def thin_surface(surface: Surface, most: int) -> Surface:
    """Return a surface with at most `most` triangles: all points in a cell of a grid become their mean.

    Rossignac and Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993.

    Parameters
    ----------
    surface : Surface
        The surface to simplify.
    most : int
        At least 12: the coarsest grid leaves no more than a box.

    Returns
    -------
    Surface
        The surface itself where it has few enough triangles.
    """
    cells = float(_FINEST)
    coarser = surface
    # Every grid starts from the whole surface, so that the errors of one do not enter the next.
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


_MOST_SLICES = 3
_WORTH_SLICING = 0.95
"""A finer slicing must bring the volume of the capsules around the slices down to this share."""
_LARGEST = 1e6
"""Largest coordinate in m: no machine is that large, and squares and cubes of it are still finite."""
_THIN = 1e-4
"""Thickness in m below which a piece counts as flat."""


def read_surface(file: Path, scale: FloatArray, placement: FloatArray) -> Surface:
    """Read a mesh file (STL, OBJ, PLY or DAE, by the ending of its name) as a surface.

    Nothing but the file is read, whatever it names.

    Parameters
    ----------
    file : Path
        The mesh file.
    scale : ndarray (3,)
        Factors along the axes of the mesh.
    placement : ndarray (4, 4)
        Transform of the scaled mesh (m).

    Returns
    -------
    Surface
        Points in m, in the frame that `placement` leads to.

    Raises
    ------
    ValueError
        The file cannot be read as a mesh.
    """
    points, triangles = read_triangles(file)
    with np.errstate(over="ignore", invalid="ignore"):  # what comes of too large numbers is refused below
        points = (points * scale) @ placement[:3, :3].T + placement[:3, 3]
    if not (np.abs(points) <= _LARGEST).all():
        raise ValueError(f"it has corners that are no numbers, or more than {_LARGEST:g} m away")
    return Surface(points, triangles)


def build_hulls(surface: Surface) -> tuple[Hull | Block, ...]:
    """Return convex pieces that enclose a surface: slices across a principal axis if they fit closer than one hull."""
    return tuple(_build_hull(piece) for piece in slice_mesh(surface.points, surface.triangles))


def _build_hull(points: FloatArray) -> Hull | Block:
    """Return the convex hull of points (m, 3), or the box around them if they are flat: a hull needs a volume."""
    middle = points.mean(axis=0)
    # The three rows of zeros give all three principal axes, however few points there are.
    axes = np.linalg.svd(np.vstack([points - middle, np.zeros((3, 3))]))[2]
    # Right-handed axes: the placement of a box must not mirror it.
    axes[2] *= np.sign(np.linalg.det(axes))
    along = (points - middle) @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    if len(points) > 3 and (high - low).min() >= _THIN:
        return Hull(points)
    placement = np.eye(4)
    placement[:3, :3] = axes.T
    placement[:3, 3] = middle + axes.T @ (0.5 * (low + high))
    return Block(placement, np.maximum(high - low, _THIN))


def slice_mesh(points: FloatArray, triangles: NDArray[np.intp]) -> list[FloatArray]:
    """Return the corners of the convex pieces of a mesh with points (m, 3) and triangles (k, 3)."""
    used = np.unique(triangles)
    axes = np.linalg.svd(points[used] - points[used].mean(axis=0), full_matrices=False)[2]
    best = [_hull_corners(points[used])]
    least = _sum_volumes(best)
    # Compare by the volume of the enclosing capsules, since these are what distances are computed between.
    for count in range(2, _MOST_SLICES + 1):
        for axis in axes:
            pieces = [_hull_corners(piece) for piece in _cut_slices(points, triangles, axis, count) if len(piece)]
            volume = _sum_volumes(pieces)
            if volume < _WORTH_SLICING * least:
                best, least = pieces, volume
    return best


def _cut_slices(points: FloatArray, triangles: NDArray[np.intp], axis: FloatArray, count: int) -> list[FloatArray]:
    """Return the points of the surface in each of `count` slices: corners inside, and edges cut at the borders."""
    along = points @ axis
    borders = np.linspace(along.min(), along.max(), count + 1)
    edges = np.unique(
        np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])), axis=0
    )
    used = np.unique(triangles)
    slices = []
    for low, high in itertools.pairwise(borders):
        inside = points[used[(along[used] >= low) & (along[used] <= high)]]
        # Where an edge crosses a border, both slices get the point, so that the pieces leave no gap.
        crossing = [_intersect_edges(points, along, edges, border) for border in (low, high)]
        slices.append(np.concatenate([inside, *crossing]))
    return slices


def _intersect_edges(points: FloatArray, along: FloatArray, edges: NDArray[np.intp], border: float) -> FloatArray:
    a, b = edges.T
    crossed = (along[a] - border) * (along[b] - border) < 0
    a, b = a[crossed], b[crossed]
    share = (border - along[a]) / (along[b] - along[a])
    intersections: FloatArray = points[a] + share[:, None] * (points[b] - points[a])
    return intersections


def _hull_corners(points: FloatArray) -> FloatArray:
    """Return the corners of the convex hull, or all points if they are flat."""
    try:
        corners: FloatArray = points[ConvexHull(points).vertices]
    except QhullError:
        return points
    return corners


def _sum_volumes(pieces: list[FloatArray]) -> float:
    return sum(enclose_points(piece).volume for piece in pieces)
