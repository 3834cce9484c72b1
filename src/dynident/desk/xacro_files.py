"""Xacro files as the URDF that they expand to."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from dynident.errors import DynidentError
from dynident.extras import install_hint
from dynident.robot.packages import find_package

_TITLE = "Unusable xacro"
_USED = re.compile(r"<\s*xacro:|\$\{|\$\(")
_ROS_INDEX = "ament_index_python"


def expanded(path: Path, content: str) -> str:
    """The URDF of a file: the content itself where it is no xacro.

    Files that it includes are read from beside it, those of packages from the folders above it or where the ROS
    environment says. It is for files of one's own: xacro evaluates what they say.

    Raises
    ------
    DynidentError
        The package xacro is not installed, or it cannot expand the file.
    """
    if not _USED.search(content):
        return content
    try:
        import xacro
    except ModuleNotFoundError as missing:
        raise DynidentError(
            "this is xacro, which is expanded with the package xacro, and that is not installed: "
            f"{install_hint('xacro')}; or expand it first (xacro robot.xacro > robot.urdf)",
            pointer=str(path),
            title=_TITLE,
        ) from missing
    try:
        with _packages_found_near(path):
            return str(xacro.process_file(str(path)).toprettyxml(indent="  "))
    except Exception as error:  # its own kinds of error are many, and all are about the file
        cause: Any = error
        while getattr(cause, "exc", None) is not None and not isinstance(cause, _PackageNotFound):
            cause = cause.exc
        reason = str(cause if isinstance(cause, _PackageNotFound) else error).strip() or type(error).__name__
        raise DynidentError(f"xacro cannot expand it: {reason}", pointer=str(path), title=_TITLE) from error


class _PackageNotFound(Exception):
    """No folder of a package that a file names with $(find …)."""


@contextmanager
def _packages_found_near(path: Path) -> Iterator[None]:
    """Let xacro's $(find package) find what lies near a file, where ROS itself is not installed or does not know it.

    xacro asks the ROS package `ament_index_python`, which is on no package index; this stands in for it.
    """
    known = {name: sys.modules.get(name) for name in (_ROS_INDEX, f"{_ROS_INDEX}.packages")}
    ask_ros = _ros_index()

    def get_package_share_directory(name: str) -> str:
        folder = find_package(name, path)
        if folder is not None:
            return str(folder)
        if ask_ros is not None:
            return str(ask_ros(name))
        raise _PackageNotFound(
            f"there is no folder of the package {name!r} in the folders above {path.name}; put it beside the file's "
            "own package, or name the folder that holds it in the environment variable ROS_PACKAGE_PATH"
        )

    packages: Any = ModuleType(f"{_ROS_INDEX}.packages")
    packages.get_package_share_directory = get_package_share_directory
    index: Any = ModuleType(_ROS_INDEX)
    index.packages = packages
    sys.modules.update({_ROS_INDEX: index, packages.__name__: packages})
    try:
        yield
    finally:
        for name, module in known.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def _ros_index() -> Any:
    try:
        return import_module(f"{_ROS_INDEX}.packages").get_package_share_directory
    except ImportError:
        return None
