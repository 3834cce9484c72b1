"""Which format a file is in, told from its first bytes, and who reads it."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from dynident.encoding import encodable
from dynident.recordings.cells import with_words
from dynident.recordings.formats.contents import TextContent
from dynident.recordings.formats.tables import CsvFileSource, ParquetFileSource
from dynident.recordings.formats.telegrams import START, telegram_source
from dynident.recordings.raw import FileSource
from dynident.recordings.stamps import with_stamps
from dynident.recordings.stated import Format
from dynident.recordings.types import RecordingError

FORMATS: tuple[str, ...] = get_args(Format)

_STARTS: tuple[tuple[bytes, Format], ...] = (
    (b"PAR1", "parquet"),
    (b"\x93NUMPY", "npy"),
    (b"PK\x03\x04", "npz"),
    (b"MATLAB 5.0", "mat"),
    (b"MATLAB 7.3", "hdf5"),
    (b"\x89HDF", "hdf5"),
    (b"#ROSBAG", "rosbag"),
    (b"SQLite format 3", "rosbag2"),
    (b"\x89MCAP", "mcap"),
)

_WRITTEN = {"csv": "CSV", "parquet": "Parquet"}
_LOOKED_AT = 4096
"""Bytes: a logger may write some lines of its own before the first telegram."""


def format_of(path: Path) -> str:
    """Tell the format of a file; "csv" for whatever is none of the others.

    Raises
    ------
    RecordingError
        For an empty file.
    """
    with path.open("rb") as file:
        start = file.read(_LOOKED_AT)
    if not start:
        raise RecordingError("The file is empty.", title="Unreadable file")
    found = next((name for first, name in _STARTS if start.startswith(first)), None)
    return found or ("rsi" if START.search(start) else "csv")


def open_source(path: Path, file_format: str | None) -> FileSource:
    """Open a user's file; the format is told from its first bytes where it is not given.

    Raises
    ------
    RecordingError
        If the file is empty, or not what it is said to be, or its name is no text.
    """
    if encodable(str(path)) != str(path):
        raise RecordingError(
            f"The file's name {encodable(path.name)!r} is no UTF-8; rename it.", title="Unreadable file"
        )
    return with_stamps(with_words(_open_source(path, file_format)))


def _open_source(path: Path, file_format: str | None) -> FileSource:
    found = format_of(path)
    if file_format == "parquet" and found == "csv":
        return ParquetFileSource(path)  # which says what is wrong with it
    if file_format not in (None, found) and (found, file_format) != ("hdf5", "mat"):
        raise RecordingError(
            f'The file is {_WRITTEN.get(found, found)}, not {_WRITTEN.get(file_format, file_format)}; say "format": '
            f'"{found}".',
            pointer="/format",
        )
    if found == "parquet":
        return ParquetFileSource(path)
    return CsvFileSource(TextContent(path)) if found == "csv" else _open_foreign(path, found)


def _open_foreign(path: Path, name: str) -> FileSource:
    """Open a file of a format that is neither CSV nor Parquet.

    Raises
    ------
    RecordingError
        For a file that cannot be read, or a package that reads it and is not installed.
    """
    try:
        if name in ("npy", "npz"):
            from dynident.recordings.formats.numpy_files import numpy_source

            return numpy_source(path, name)
        if name == "mat":
            from dynident.recordings.formats.matlab import matlab_source

            return matlab_source(path)
        if name == "hdf5":
            from dynident.recordings.formats.hdf5 import hdf5_source

            return hdf5_source(path)
        if name == "rsi":
            return telegram_source(path)
        from dynident.recordings.formats.bags import bag_source

        return bag_source(path, name)
    except ModuleNotFoundError as missing:
        raise RecordingError(
            f"Files of the format {name} are read with the package {missing.name}, which is not installed: "
            "pip install 'dynident[formats]'. Or export the file as CSV or Parquet.",
            pointer="/format",
            title="Not installed",
        ) from missing
