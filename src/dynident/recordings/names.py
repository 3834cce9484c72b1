"""Names of recordings, after their files, and the files of which a path is made."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from dynident.errors import DynidentError

JOINT = "+"
"""Stands between the files of one recording: q.csv+dq.csv+tau.csv."""


def make_unique_names(paths: Iterable[Path]) -> list[str]:
    """Return a name for every file: its stem, with a number behind it if two files share one.

    Parameters
    ----------
    paths : iterable of path

    Returns
    -------
    list of str
    """
    names: list[str] = []
    for path in paths:
        stem = split_path(path)[0].stem
        name, count = stem, 2
        while name in names:
            name, count = f"{stem}_{count}", count + 1
        names.append(name)
    return names


def split_path(path: Path) -> list[Path]:
    """Return the files that a path names: itself, or those of `folder/q.csv+tau.csv`, which lie beside the first.

    Parameters
    ----------
    path : path
        A file whose own name has a + in it is that file.

    Returns
    -------
    list of path
        They need not exist.
    """
    text = str(path)
    if JOINT not in text or path.exists():
        return [path]
    first, *others = (Path(part) for part in text.split(JOINT))
    return [first, *(other if other.exists() else first.parent / other for other in others)]


def check_readable_path(path: str | Path | tuple[str | Path, ...]) -> Path:
    """Return the path of a recording, in one file or in several.

    Parameters
    ----------
    path : str, path, or tuple of them
        A tuple for one recording in several files.

    Returns
    -------
    path

    Raises
    ------
    DynidentError
        For what is no path, or a file that is not there.
    """
    several = (path,) if isinstance(path, (str, Path)) else path
    if not (isinstance(several, tuple) and several and all(isinstance(part, (str, Path)) for part in several)):
        raise DynidentError(
            f"{path!r} is no path; give the files one by one, read_recordings(*paths, robot=robot), and as a tuple "
            "those that are one recording"
        )
    joined = Path(JOINT.join(map(str, several)))
    for part in split_path(joined):
        if not part.is_file():
            raise DynidentError(f"there is no file {part}", pointer=str(part), title="No such file")
    return joined
