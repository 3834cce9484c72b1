"""Xacro files as the URDF that they expand to."""

from __future__ import annotations

import re
from pathlib import Path

from dynident.errors import DynidentError
from dynident.extras import install_hint

_TITLE = "Unusable xacro"
_USED = re.compile(r"<\s*xacro:|\$\{|\$\(")


def expanded(path: Path, content: str) -> str:
    """The URDF of a file: the content itself where it is no xacro.

    Files that it includes are read from beside it. It is for files of one's own: xacro evaluates what they say.

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
        return str(xacro.process_file(str(path)).toprettyxml(indent="  "))
    except Exception as error:  # its own kinds of error are many, and all are about the file
        told = " ".join(str(part) for part in (getattr(error, "message", None) or error,)).strip()
        hint = " (files of ROS packages are found where ROS is set up: expand it there)" if "$(find" in content else ""
        raise DynidentError(
            f"xacro cannot expand it: {told or type(error).__name__}{hint}", pointer=str(path), title=_TITLE
        ) from error
