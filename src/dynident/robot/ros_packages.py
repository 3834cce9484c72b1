"""Folders in which package:// and $(find …) names of a description are looked for on this machine."""

from __future__ import annotations

import os
from pathlib import Path

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
