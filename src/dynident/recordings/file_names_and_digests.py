"""Names, extensions and digests of recording files, and archives of several; the most files of a recording (64)."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile, ZipInfo

from dynident.errors import DynidentError

MOST_FILES = 64
"""Files of one recording; signals of joints need fewer than ten."""


def pack_files(files: Sequence[tuple[str, Path]], target: Path) -> None:
    """Write an archive (.zip) of files by their names; the same files give the same bytes.

    Parameters
    ----------
    files : sequence of (str, path)
        Name in the archive and place of every file.
    target : path
        The archive that is written.
    """
    with ZipFile(target, "w", ZIP_STORED) as archive:
        for name, path in files:
            # ZipInfo without a date: the archive depends on the content alone.
            with path.open("rb") as source, archive.open(ZipInfo(name), "w", force_zip64=True) as member:
                shutil.copyfileobj(source, member, 1 << 20)


def compute_digest(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits; of a recording in several files, that of their digests.

    Parameters
    ----------
    path : path
        Where the file lies; the files of one recording are joined by +.

    Returns
    -------
    str
        Digest of 64 hexadecimal digits.

    Raises
    ------
    OSError
        For a file that cannot be read.
    """
    parts = split_path(path)
    if len(parts) > 1:
        # Of their digests, and not of all bytes in a row: where one file ends and the next begins counts.
        return hashlib.sha256("".join(compute_digest(part) for part in parts).encode()).hexdigest()
    with parts[0].open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


JOINT = "+"
"""Stands between the files of one recording: q.csv+dq.csv+tau.csv."""


def make_unique_names(paths: Iterable[Path]) -> list[str]:
    """Return a name for every file: its stem, with a number behind it if two files share one.

    Parameters
    ----------
    paths : iterable of path
        Where the files lie.

    Returns
    -------
    list of str
        The names, in the order of the files.
    """
    return number_repeated_names([split_path(path)[0].stem for path in paths])


def number_repeated_names(names: Iterable[str]) -> list[str]:
    """Return names with a number behind those that were there before.

    Parameters
    ----------
    names : iterable of str
        The names.
    """
    unique: list[str] = []
    for stem in names:
        name, count = stem, 2
        while name in unique:
            name, count = f"{stem}_{count}", count + 1
        unique.append(name)
    return unique


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
    # A file whose own name has a + in it goes before the several that it might mean.
    if JOINT not in text or _exists(path):
        return [path]
    pieces = text.split(JOINT)
    files: list[Path] = []
    while pieces:
        # A folder may have a + in its name, too: as many pieces as make the path of a file.
        folder = files[0].parent if files else Path()
        trials = ((end, Path(JOINT.join(pieces[:end]))) for end in range(1, min(len(pieces), _MOST_PIECES) + 1))
        places = ((end, place) for end, trial in trials for place in (trial, folder / trial))
        end, file = next(((end, place) for end, place in places if _is_file(place)), (1, folder / pieces[0]))
        files, pieces = [*files, file], pieces[end:]
    return files


_MOST_PIECES = 8  # of the path of one file


def _is_file(path: Path) -> bool:
    """Tell whether a path is that of a file; a folder beside it may be called as its first piece is."""
    return _exists(path) and path.is_file()


def _exists(path: Path) -> bool:
    """Tell whether a file exists; one cannot whose name is longer than the system allows, as of many joined names."""
    try:
        return path.exists()
    except OSError:
        return False


def check_readable_path(path: str | Path | tuple[str | Path, ...]) -> Path:
    """Return the path of a recording, in one file or in several.

    Parameters
    ----------
    path : str, path, or tuple of them
        A tuple for one recording in several files.

    Returns
    -------
    path
        The path, or the paths of the files joined by +.

    Raises
    ------
    DynidentError
        For what is no path, or a file that is not there.
    """
    several = (path,) if isinstance(path, (str, Path)) else path
    if not (isinstance(several, tuple) and several and all(isinstance(part, (str, Path)) for part in several)):
        raise DynidentError(
            f"{path!r} is not a path; give the files one by one, read_recordings(*paths, robot=robot), and the files "
            "of one recording as a tuple"
        )
    joined = Path(JOINT.join(map(str, several)))
    for part in split_path(joined):
        if part.is_dir():
            raise DynidentError(describe_folder(part), pointer=str(part), title="No such file")
        if not part.is_file():
            raise DynidentError(f"there is no file {part}", pointer=str(part), title="No such file")
    return joined


_IN_FOLDERS = {"a bag": ("*.db3", "*.mcap"), "a LeRobot data set": ("data/*/*.parquet",)}
"""Files of recordings in the folders that loggers write, by what the folder is."""


def describe_folder(folder: Path) -> str:
    """Return a sentence on a folder that was given for a recording: which file in it to give.

    Parameters
    ----------
    folder : path
        An existing folder.
    """
    for what, patterns in _IN_FOLDERS.items():
        files = [file for pattern in patterns for file in sorted(folder.glob(pattern))]
        if files:
            return f"{folder} is the folder of {what}; give the file in it: {files[0]}"
    return f"{folder} is a folder; give the files in it one by one, those of one recording joined as q.csv+tau.csv"
