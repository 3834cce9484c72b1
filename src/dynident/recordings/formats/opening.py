"""Which format a file is in, told from its first bytes, and who reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from dynident.recordings.formats.telegrams import START, telegram_source
from dynident.recordings.raw import FileSource
from dynident.recordings.types import RecordingError

Format = Literal["csv", "parquet", "npy", "npz", "mat", "hdf5", "rosbag", "rosbag2", "mcap", "rsi"]
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


def open_foreign(path: Path, name: str) -> FileSource:
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
