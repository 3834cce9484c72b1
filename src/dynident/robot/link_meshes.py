"""Meshes of links: find files (package://), simplify them, and split them into convex pieces.

Names with package:// and $(find …) are looked for in the folders of ROS packages on this machine.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
import scipy
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.robot.collision_shapes import Block, Hull, enclose_points
from dynident.robot.json_fields import join_names
from dynident.robot.mesh_readers import read_triangles

_ROS_FOLDERS = (("ROS_PACKAGE_PATH", "."), ("AMENT_PREFIX_PATH", "share"), ("CMAKE_PREFIX_PATH", "share"))
"""Variables of a ROS environment that hold lists of folders, and where the packages are below each."""


def list_package_folders(file: Path) -> tuple[Path, ...]:
    """Return the folders that may hold the packages which a description's file names, nearest first.

    First come the folders above the file, without the root of the file system, since a description lies in its package
    or beside it; then those of the ROS environment.
    """
    above = file.resolve().parents[:-1]
    ros_folders = [
        Path(folder) / below for name, below in _ROS_FOLDERS for folder in _split_folders(os.environ.get(name, ""))
    ]
    return tuple(dict.fromkeys([*above, *ros_folders]))


def find_package(name: str, file: Path) -> Path | None:
    """Return the folder of a package that a description's file names.

    Parameters
    ----------
    name : str
        Name of the package.
    file : Path
        The description's file.

    Returns
    -------
    Path or None
        None if there is none.
    """
    return next((folder / name for folder in list_package_folders(file) if (folder / name).is_dir()), None)


def _split_folders(text: str) -> list[str]:
    return [folder for folder in text.split(os.pathsep) if folder]


_PREFIXES = ("package://", "model://", "file://")


def find_mesh_file(uri: str, folders: Iterable[Path]) -> Path | None:
    """Return the file that a mesh's name means, below one of some folders.

    Parameters
    ----------
    uri : str
        Name of the mesh in the description.
    folders : iterable of Path
        Where it is looked for, in this order.

    Returns
    -------
    Path or None
        None if there is no such file.
    """
    return next((path for path in list_candidate_files(uri, folders) if _is_file(path)), None)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that no file can have
        return False


def list_candidate_files(uri: str, folders: Iterable[Path]) -> list[Path]:
    """Return the files that a mesh's name may mean, in the order of the search.

    For package://robot/meshes/x.stl both robot/meshes/x.stl and meshes/x.stl are looked for in the folders.

    Parameters
    ----------
    uri : str
        Name of the mesh in the description.
    folders : iterable of Path
        Where it is looked for, in this order.

    Returns
    -------
    list of Path
        Whether or not they exist; none outside of the folders.
    """
    packaged = not uri.startswith("file://") and any(uri.startswith(prefix) for prefix in _PREFIXES)
    name = uri
    for prefix in _PREFIXES:
        name = name.removeprefix(prefix)
    path, search_folders = Path(name), list(folders)
    candidates = [folder / part for folder in search_folders for part in _list_tails(path, packaged)]
    # A description may come from anywhere: it opens no file outside of the folders that its user names.
    if path.is_absolute() and any(path.resolve().is_relative_to(folder.resolve()) for folder in search_folders):
        candidates.insert(0, path)
    return candidates


def _list_tails(path: Path, packaged: bool) -> list[Path]:
    # Without ".." and the root, a name cannot lead out of the folder that it is looked for in.
    parts = [part for part in path.parts if part not in ("/", "..")]
    if not parts:
        return []
    return [Path(*parts), Path(*parts[1:])] if packaged and len(parts) > 1 else [Path(*parts)]


def link_mesh_files(folder: Path, files: Mapping[str, Path]) -> None:
    """Link the files of meshes into a folder, so that `find_mesh_file` finds them there.

    Parameters
    ----------
    folder : Path
        The folder, which need not be empty.
    files : mapping of str to Path
        Files by the mesh's name in the description.

    Raises
    ------
    DynidentError
        If no file can have the name of a mesh, or two names exclude each other as files.
    """
    for uri, file in files.items():
        link = list_candidate_files(uri, [folder])[0]
        try:
            link.parent.mkdir(parents=True, exist_ok=True)
            if not link.exists():
                link.symlink_to(file.resolve())
        except (OSError, ValueError) as error:
            detail = f"a file cannot have the name of the mesh {uri[:200]!r} ({error.__class__.__name__}); rename it"
            raise DynidentError(detail, pointer="/files", title="Unusable name of a mesh") from None


def match_mesh_files(uris: Iterable[str], names: Sequence[str]) -> dict[str, str]:
    """Match meshes of a description to files by their names.

    A file matches if it has the same file name, upper or lower case; of several the one with most folders in common.

    Parameters
    ----------
    uris : iterable of str
        Names of meshes in the description.
    names : sequence of str
        Paths or bare names of the files.

    Returns
    -------
    dict of uri to name
        Meshes without a file are left out.

    Raises
    ------
    DynidentError
        If two files match a mesh equally well, or a file matches two meshes equally well.
    """
    best_match: dict[str, tuple[str, int]] = {}
    for uri in uris:
        path = list_candidate_files(uri, [Path()])[:1]
        # Zero means another file name: such a file never matches.
        likeness = [_count_common_parts(path[0].as_posix(), name) if path else 0 for name in names]
        most = max(likeness, default=0)
        best = [name for name, value in zip(names, likeness, strict=True) if value == most > 0]
        if len(best) > 1:
            raise _make_ambiguity_error(f"{join_names(best)} all match {uri}")
        if best:
            best_match[uri] = best[0], most
    return {
        uri: name for uri, (name, likeness) in best_match.items() if _is_best_match(uri, name, likeness, best_match)
    }


def _is_best_match(uri: str, name: str, likeness: int, best_match: Mapping[str, tuple[str, int]]) -> bool:
    """Return whether no other mesh matches a file better; raise if another matches it equally well."""
    others = {other: value for other, (file, value) in best_match.items() if file == name and other != uri}
    if any(value > likeness for value in others.values()):
        return False
    alike = [other for other, value in others.items() if value == likeness]
    if alike:
        raise _make_ambiguity_error(f"{name} could be {uri} or {join_names(alike)}")
    return True


def _count_common_parts(first: str, second: str) -> int:
    """Return how many parts two paths have in common, counted from the end."""
    number = 0
    for a, b in zip(reversed(_split_path(first)), reversed(_split_path(second)), strict=False):
        if a != b:
            break
        number += 1
    return number


def _split_path(path: str) -> tuple[str, ...]:
    return tuple(part.casefold() for part in PurePosixPath(path.replace("\\", "/")).parts)


def _make_ambiguity_error(problem: str) -> DynidentError:
    detail = f"{problem}; send the meshes with their folders, as in the description"
    return DynidentError(detail, pointer="/files", title="Ambiguous mesh")


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
        raise ValueError(f"it has vertices that are not numbers, or more than {_LARGEST:g} m from the origin")
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
        corners: FloatArray = points[scipy.spatial.ConvexHull(points).vertices]
    except scipy.spatial.QhullError:
        return points
    return corners


def _sum_volumes(pieces: list[FloatArray]) -> float:
    return sum(enclose_points(piece).volume for piece in pieces)
