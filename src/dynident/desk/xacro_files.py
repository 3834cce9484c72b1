"""Expansion of xacro files to URDF."""

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
from dynident.extras import format_install_hint
from dynident.robot.packages import find_package

_XACRO_TITLE = "Unusable xacro"
_XACRO_SYNTAX = re.compile(r"<\s*xacro:|\$\{|\$\(")
_ROS_INDEX = "ament_index_python"


def expand_xacro(path: Path, content: str) -> str:
    """Return the URDF of a file: its content, expanded where it is xacro.

    Included files are read from the folder of the file, those of packages from the folders above it or where the ROS
    environment says. Only for trusted files: xacro evaluates the expressions in them.

    Parameters
    ----------
    path : Path
    content : str
        Of the file.

    Returns
    -------
    str

    Raises
    ------
    DynidentError
        The package xacro is not installed, or it cannot expand the file.
    """
    if not _XACRO_SYNTAX.search(content):
        return content
    try:
        import xacro
    except ModuleNotFoundError as missing:
        raise DynidentError(
            "this is xacro, which is expanded with the package xacro, and that is not installed: "
            f"{format_install_hint('xacro')}; or expand it first (xacro robot.xacro > robot.urdf)",
            pointer=str(path),
            title=_XACRO_TITLE,
        ) from missing
    try:
        with _find_packages_near(path):
            return str(xacro.process_file(str(path)).toprettyxml(indent="  "))
    except Exception as error:  # xacro raises many kinds of errors, all about the file
        cause: Any = error
        # xacro wraps what our own search raises, perhaps several times. Its message would hide ours.
        while getattr(cause, "exc", None) is not None and not isinstance(cause, _PackageNotFound):
            cause = cause.exc
        reason = str(cause if isinstance(cause, _PackageNotFound) else error).strip() or type(error).__name__
        raise DynidentError(f"xacro cannot expand it: {reason}", pointer=str(path), title=_XACRO_TITLE) from error


class _PackageNotFound(Exception):
    """Raised for a package whose folder is not found, though a file names it with $(find …)."""


@contextmanager
def _find_packages_near(path: Path) -> Iterator[None]:
    """Let xacro's $(find package) search near a file, where ROS is not installed or does not know the package.

    xacro asks the ROS package `ament_index_python`, which is on no package index; a stand-in replaces it meanwhile.
    """
    replaced = {name: sys.modules.get(name) for name in (_ROS_INDEX, f"{_ROS_INDEX}.packages")}
    ask_ros = _get_ros_index()

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
        for name, module in replaced.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def _get_ros_index() -> Any:
    try:
        return import_module(f"{_ROS_INDEX}.packages").get_package_share_directory
    except ImportError:
        return None
