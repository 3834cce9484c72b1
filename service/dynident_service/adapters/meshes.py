"""Uploaded mesh files of a robot: which file is which mesh, and folders in which they are found by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from dynident.errors import DynidentError
from dynident.robot import Robot
from dynident.robot.collision import list_collision_meshes
from dynident.robot.mesh_files import find_mesh_file, link_mesh_files, match_mesh_files
from dynident.robot.meshes import read_surface
from dynident_service.adapters.geometry import describe_geometry
from dynident_service.models.geometry import GeometryView


@contextmanager
def place_mesh_files(files: Mapping[str, Path]) -> Iterator[tuple[Path, ...]]:
    """Place mesh files in a temporary folder under the names that the description gives them.

    Parameters
    ----------
    files : mapping of Path
        Files by the name of the mesh.

    Yields
    ------
    tuple of Path
        The folder, which is removed when the context ends; empty without files.
    """
    if not files:
        yield ()
        return
    with TemporaryDirectory() as name:
        link_mesh_files(Path(name), files)
        yield (Path(name),)


def assign_mesh_files(robot: Robot, sent: Mapping[str, Path]) -> dict[str, str]:
    """Assign uploaded files to the meshes of a robot's description, and check that each can be read.

    Parameters
    ----------
    robot : Robot
        The robot.
    sent : mapping of Path
        Uploaded files by the name they were sent with.

    Returns
    -------
    dict of str
        The name of the uploaded file by the name of the mesh.

    Raises
    ------
    DynidentError
        Where the description names no meshes, no file matches, or a file is no mesh.
    """
    needed = list_collision_meshes(robot)
    if not needed:
        raise DynidentError(
            "the robot's description names no meshes in its <collision> elements, so none can be sent for it",
            pointer="/files",
            title="No meshes named",
        )
    files_by_mesh = match_mesh_files(needed, list(sent))
    if not files_by_mesh:
        raise DynidentError(
            f"none of the {len(sent)} files has the name of a mesh of the description: {', '.join(list(needed)[:8])}",
            pointer="/files",
            title="Unknown mesh",
        )
    with place_mesh_files({name: sent[file] for name, file in files_by_mesh.items()}) as folders:
        for name, file in files_by_mesh.items():
            placed = find_mesh_file(name, folders)
            assert placed is not None
            # Scale and placement do not matter here: reading it is the test.
            try:
                read_surface(placed, np.ones(3), np.eye(4))
            except ValueError as error:
                detail = f"{file} cannot be read as a mesh: {error}; send STL, OBJ, DAE or PLY"
                raise DynidentError(detail, pointer="/files", title="Unreadable mesh") from None
    return files_by_mesh


def describe_geometry_with_meshes(robot: Robot, files: Mapping[str, Path]) -> GeometryView:
    """Build the view of a robot's geometry with the files of its meshes, by name."""
    with place_mesh_files(files) as folders:
        return describe_geometry(robot, folders)
