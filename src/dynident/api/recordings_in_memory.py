"""Recordings from arrays, dictionaries and data frames; they are written to temporary files and read like any file."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynident.errors import DynidentError, describe_value
from dynident.recordings.arrow_tables import pc
from dynident.recordings.csv_dialects import join_name_levels
from dynident.recordings.file_names_and_digests import check_readable_path, split_path
from dynident.robot import Robot


class ArrowFrame(Protocol):
    """A data frame of pandas, polars or Arrow, which gives its columns by Arrow's interface."""

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Return the columns as a capsule."""
        ...


RecordingData = str | Path | tuple[str | Path, ...] | Mapping[str, object] | ArrowFrame
"""A path, several paths of one recording, a dictionary of columns, or a data frame (of pandas, polars or Arrow)."""

_TITLE = "Unusable data"
_KINDS = ("q", "dq", "ddq", "tau", "current", "temperature", "q_command")
"""Signals of joints that a dictionary may hold as one array (m, n)."""
_UNNAMED_INDEX = "__index_level_0__"


@dataclass(frozen=True, eq=False)
class SourceFile:
    """The file of a recording that is to be read.

    Parameters
    ----------
    path : Path
        The user's file, or a temporary one with data from memory.
    name : str
        The name of the user's file without its ending; "" of data from memory.
    rate : float or None
        Hz of the rows, where the data state a sampling period instead of times.
    owner : object
        Removes a temporary file when nothing refers to it any more; None for a user's file.
    """

    path: Path
    name: str
    rate: float | None = None
    owner: object = None


class TemporaryFile:
    """A file in this process's temporary folder, which goes when nothing refers to this object any more."""

    def __init__(self, suffix: str = ".parquet") -> None:
        # Only the name is wanted: the file is written by others, and Windows cannot open a file twice.
        with tempfile.NamedTemporaryFile(dir=_get_temporary_folder().name, suffix=suffix, delete=False) as file:
            self.path = Path(file.name)
        weakref.finalize(self, self.path.unlink, missing_ok=True)


@cache
def _get_temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """Return this process's folder for recordings, which is removed when the process ends."""
    return tempfile.TemporaryDirectory(prefix="dynident-", ignore_cleanup_errors=True)


def open_recording_source(source: RecordingData, robot: Robot) -> SourceFile:
    """Return the file of a recording; data in memory are written to a temporary one.

    Parameters
    ----------
    source : path, tuple of paths, mapping or data frame
        What a function was given as a recording.
    robot : Robot
        The robot whose joints the columns of arrays (m, n) belong to.

    Returns
    -------
    SourceFile
        The file, with the default name of the recording.

    Raises
    ------
    DynidentError
        For a file that is not there, and for what is no recording.
    """
    if isinstance(source, (str, Path)) or (isinstance(source, tuple) and not any(map(_is_array, source))):
        path = check_readable_path(source)
        return SourceFile(path, split_path(path)[0].stem)
    if isinstance(source, Mapping):
        columns, rate = _expand_columns(source, robot)
        return _write(pa.table(columns), rate)
    if hasattr(source, "__arrow_c_stream__") and hasattr(source, "columns"):
        # Names on several levels, ('position', 'elbow'), become position_elbow, as in files.
        has_levels = getattr(source.columns, "nlevels", 1) > 1
        return _write(_from_frame(source, join_name_levels if has_levels else str), None)
    remedy = (
        "give several recordings one by one, read_recordings(a, b, robot=robot)"
        if isinstance(source, list)
        else 'give the path of a file, a data frame, or a dictionary of arrays by name: {"t": t, "q": q, "tau": tau}'
    )
    raise DynidentError(f"{describe_value(source)} is not a recording; {remedy}", title=_TITLE)


def _write(table: pa.Table, rate: float | None) -> SourceFile:
    if not table.num_rows or not table.num_columns:
        raise DynidentError("the data hold no samples: there are no rows", title=_TITLE)
    owner = TemporaryFile()
    pq.write_table(table, owner.path)
    return SourceFile(owner.path, "", rate, owner)


def _from_frame(frame: Any, get_name: Callable[[str], str]) -> pa.Table:
    """Return a data frame as an Arrow table; an index of times becomes the column t."""
    table = pa.table(frame)
    names = [get_name(name) for name in table.column_names]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        alike = " and ".join(given for given, name in zip(table.column_names, names, strict=True) if name == twice)
        raise DynidentError(
            f"the columns {alike} both get the name {twice}; give them other names", pointer=twice, title=_TITLE
        )
    if _UNNAMED_INDEX in names:
        place = names.index(_UNNAMED_INDEX)
        kind = table.schema.types[place]
        # Numbers of rows that a selection left over are no signal. Instants and durations are the time of the rows.
        if "t" not in names and (pa.types.is_timestamp(kind) or pa.types.is_duration(kind)):
            names[place] = "t"
        else:
            table, names = table.remove_column(place), names[:place] + names[place + 1 :]
    table = table.rename_columns(names)
    for place, field in enumerate(table.schema):
        if pa.types.is_duration(field.type):
            nanoseconds = table.column(place).cast(pa.duration("ns")).cast(pa.int64()).cast(pa.float64(), safe=False)
            seconds = pa.chunked_array([np.asarray(nanoseconds) * 1e-9])
            table = table.set_column(place, field.name, seconds)
        elif pa.types.is_string(field.type) or pa.types.is_large_string(field.type):
            table = table.set_column(place, field.name, _read_decimal_commas(table.column(place)))
    # What pandas wrote about its index would be read again by others.
    return table.replace_schema_metadata(None)


def _read_decimal_commas(texts: pa.ChunkedArray) -> pa.ChunkedArray:
    """Return texts such as "-1,117" as numbers; other texts as they are, and those whose commas may part thousands."""
    thousands = pc.match_substring_regex(texts, r"^[+-]?[1-9]\d{0,2}(,\d{3})+$")
    commas = pc.match_substring(texts, ",")
    if pc.all(pc.equal(thousands, commas)).as_py():
        return texts
    try:
        return pc.replace_substring(texts, ",", ".").cast(pa.float64())
    except pa.ArrowInvalid:
        return texts


def _expand_columns(source: Mapping[str, Any], robot: Robot) -> tuple[dict[str, Any], float | None]:
    """Return the columns of a dictionary, arrays (m, n) as a column for each joint, and the rate that dt states."""
    columns: dict[str, Any] = {}
    rate = None
    for name, values in source.items():
        if name == "dt":
            rate = _read_rate(values)
            continue
        array = np.asarray(values)
        if array.dtype.kind not in "fiubM":
            raise DynidentError(
                f"{name} is {describe_value(values)}, which is no array of numbers",
                pointer=str(name),
                title=_TITLE,
            )
        if name in _KINDS and robot.n == 1 and array.ndim == 1:
            array = array[:, None]
        if name in _KINDS:
            if array.ndim != 2 or array.shape[1] != robot.n:
                raise DynidentError(
                    f"{name} has the shape {array.shape}; give (m, {robot.n}): a row a sample and a column a "
                    f"joint ({', '.join(robot.joint_names)})",
                    pointer=str(name),
                    title=_TITLE,
                )
            columns |= {f"{name}{joint + 1}": array[:, joint] for joint in range(robot.n)}
        elif array.ndim == 1:
            columns[str(name)] = array
        else:
            raise DynidentError(
                f"{name} has the shape {array.shape}; only {', '.join(_KINDS)} have a column a joint, all others "
                "are (m,)",
                pointer=str(name),
                title=_TITLE,
            )
    lengths = {name: len(values) for name, values in columns.items()}
    first = next(iter(lengths), "")
    other = next((name for name in lengths if lengths[name] != lengths[first]), None)
    if other is not None:
        raise DynidentError(
            f"{other} has {lengths[other]} samples and {first} has {lengths[first]}: give arrays of the same length",
            pointer=other,
            title=_TITLE,
        )
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}, rate


def _read_rate(period: Any) -> float:
    array = np.asarray(period)
    if array.ndim or array.dtype.kind not in "fiu" or not np.isfinite(array) or array <= 0:
        raise DynidentError(
            f"dt is {describe_value(period)}; give the sampling period in s, a number above 0",
            pointer="dt",
            title=_TITLE,
        )
    return 1.0 / float(array)


def _is_array(value: object) -> bool:
    return hasattr(value, "__array__")
