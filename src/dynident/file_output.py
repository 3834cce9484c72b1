"""Check the names of files to write, and write them atomically."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from dynident.errors import DynidentError

TABLE_ENDINGS = (".csv", ".parquet")
"""Endings of files that hold a table."""


def check_ending(path: str | Path, endings: tuple[str, ...]) -> Path:
    """Return the path of a file to write.

    Parameters
    ----------
    path : path
        What was given.
    endings : tuple of str
        Endings that are possible, each with its dot.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    DynidentError
        For what is no path, another ending, or a folder that does not exist.
    """
    if not isinstance(path, (str, Path)):
        raise DynidentError(f"{path!r:.60} is not a path; give the name of the file to write", pointer="path")
    file = Path(path)
    if file.suffix.lower() not in endings:
        *others, last = endings
        wanted = f"{', '.join(others)} or {last}" if others else last
        raise DynidentError(f"cannot write {file.name}; the file name must end in {wanted}", pointer=str(file))
    check_folder_exists(file)
    return file


def check_folder_exists(path: Path) -> None:
    """Check that the folder of a file exists.

    Parameters
    ----------
    path : Path
        Of the file to write.

    Raises
    ------
    DynidentError
        Where it does not.
    """
    if not path.parent.is_dir():
        raise DynidentError(f"there is no folder {path.parent}", pointer=str(path), title="No such folder")


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file atomically: it appears complete, or not at all.

    Parameters
    ----------
    path : Path
        The file.
    content : bytes
        All of its content.

    Raises
    ------
    DynidentError
        Where its folder does not exist.
    """
    check_folder_exists(path)
    # In the same folder, so that the final rename stays on one file system and is atomic.
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as unfinished:
        temporary = Path(unfinished.name)
    try:
        # Whoever reads the old file meanwhile reads all of it.
        temporary.write_bytes(content)
        # Temporary files are private (0600); this one is the user's and gets the permissions that the umask leaves.
        # The umask can only be read by setting it.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
