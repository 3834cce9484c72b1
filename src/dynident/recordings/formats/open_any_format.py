"""Detect a file's format from its first bytes and open it; the list of formats."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import from_numbers
from dynident.recordings.cells_without_numbers import read_word_cells
from dynident.recordings.file_names_and_digests import split_path
from dynident.recordings.file_source import FileSource, read_marked_gaps, to_float_column
from dynident.recordings.formats import json_records
from dynident.recordings.formats.csv_and_parquet import (
    CsvFileSource,
    FeatherFileSource,
    ParquetFileSource,
)
from dynident.recordings.formats.kuka_files import START, open_data_set, open_telegrams
from dynident.recordings.formats.matlab import is_version_4, open_matlab
from dynident.recordings.formats.multiple_files import has_arrays, open_joined_files
from dynident.recordings.formats.printed_records import find_printed_kind, rewrite_as_json
from dynident.recordings.formats.rearranged_tables import join_stacked_series, rearrange_table
from dynident.recordings.formats.text_streams import TextContent
from dynident.recordings.recording_metadata import Format, RecordingError
from dynident.recordings.sample_series_join import join_own_clocks, join_sparse_rows
from dynident.recordings.time_columns import FEWEST_STEPS, is_time_name, join_split_stamps, repair_times
from dynident.text_encoding import escape_surrogates

FORMATS: tuple[str, ...] = get_args(Format)

_STARTS: tuple[tuple[bytes, Format], ...] = (
    (b"PAR1", "parquet"),
    (b"ARROW1", "feather"),
    (b"\x93NUMPY", "npy"),
    (b"PK\x03\x04", "npz"),
    (b"MATLAB 5.0", "mat"),
    (b"MATLAB 7.3", "hdf5"),
    (b"\x89HDF", "hdf5"),
    (b"#ROSBAG", "rosbag"),
    (b"SQLite format 3", "rosbag2"),
    (b"\x89MCAP", "mcap"),
    (b"DIAEXTENDED", "diadem"),
)

_PICKLE = "a pickle of Python, which may run programs and is never opened: save the table as CSV or Parquet"
_OF_BUS = (
    "a log of raw frames of a bus: decode it to signals with their units first, by the drives' description (DBC, ESI)"
)
_BY_CANTOOLS = (
    "in Python read them with can.LogReader, decode them with decode_message of cantools, and write a line of JSON for "
    'each, {"t": 12.34, "Motor1.position": 0.5, …}'
)
_NOT_READ = (
    (b"\xd0\xcf\x11\xe0", "an Excel workbook (.xls): save the sheet as CSV."),
    *((b"\x80" + bytes([protocol]), f"{_PICKLE}.") for protocol in range(2, 6)),
    (
        b"version https://git-lfs",
        "a pointer of Git LFS, and not the file that it stands for: fetch that with `git lfs pull`.",
    ),
    (b"# Created by Octave", "Octave's text: write it again with save('-v7', 'run.mat', 't', 'q', 'tau'), or as CSV."),
    (b"<!DOCTYPE html", "a page of the web, and not the file that it shows: download that itself (raw)."),
    (b"<html", "a page of the web, and not the file that it shows: download that itself (raw)."),
    (b"FEA1", "a Feather file of version 1: write it again with df.to_feather(…), or as Parquet or CSV."),
    (b"TDSm", "a TDMS file of LabVIEW: export it as CSV, or write it again with nptdms and df.to_parquet(…)."),
    (
        b"MDF     ",
        "an MDF measurement (.mf4, .dat): export it as CSV, or with asammdf: mdf.to_dataframe().to_parquet(…).",
    ),
    (b"LOGG\x90", f"{_OF_BUS} (.blf)."),
    (b"\xd4\xc3\xb2\xa1", f"{_OF_BUS} (.pcap)."),
    (b"\x4d\x3c\xb2\xa1", f"{_OF_BUS} (.pcap)."),
    (b"CDF\x01", "a NetCDF file of version 3: write it again as NetCDF 4, or as Parquet or CSV."),
    (b"CDF\x02", "a NetCDF file of version 3: write it again as NetCDF 4, or as Parquet or CSV."),
    (b"7z\xbc\xaf", "an archive (.7z): unpack it, and give the file in it."),
    (b"\xfd7zXZ", "compressed with xz: unpack it (xz -d), or compress it with gzip or zstd."),
    (b"Rar!", "an archive (.rar): unpack it, and give the file in it."),
    (b"RDX2\n", "data of R: write the table with write.csv(…, row.names = FALSE)."),
    (b"RDX3\n", "data of R: write the table with write.csv(…, row.names = FALSE)."),
    (b"Obj\x01", "an Avro file: write it as Parquet or CSV."),
    (b"%PDF", "a PDF: give the table of numbers itself."),
    (b"\x89PNG", "a picture: give the table of numbers itself."),
    (b"ULog", "a log of PX4 (.ulg): convert it with ulog2csv."),
)
_TEXTS_NOT_READ = (
    (rb"^(?:\((?:dp?|lp?|i)\d*|c[a-z_]\w*(?:\.\w+)*\n\w+)\n", f"{_PICKLE}."),
    (rb"^\n\r\r\n", f"{_OF_BUS} (.pcapng)."),
    (rb"^\s*<\?xml", "XML: write a table, one row for each moment, as CSV or JSON lines."),
    (rb"^\s*\(\d+\.\d+\) +\w+ +[0-9A-Fa-f]+#", f"{_OF_BUS}: {_BY_CANTOOLS}."),
    (
        rb"^\s*(?:\(\d+\.\d+\) +)?\w+ +(?:[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) +\[\d\d?\](?: +[0-9A-Fa-f]{2}\s|[^\S\n]*\n)",
        f"frames of a bus as text: {_BY_CANTOOLS}.",
    ),
    (
        rb"^[^\s,]+(?:,[^\s,=]+=[^\s,]+)+ [^\s,=]+=[^\s,]+(?:,[^\s,=]+=[^\s,]+)* \d{10,19}\s",
        "InfluxDB's line protocol: query it with pivot(…), one row for each moment, and write that as CSV.",
    ),
    (rb"^\s*\{\s*\{\s*[-+]?\d+\.", 'a list of Mathematica: write it again with Export["run.csv", data].'),
    (
        rb"^(?:[^\n]*\n){0,9}?\[\[[A-Za-z_][\w.]*\]\][^\S\n]*\n\s*+\w+ *=",
        "TOML: write an object of JSON a line instead, or a table as CSV.",
    ),
    (
        rb"(?i)^\s*+(?:(?:--|/\*)[^\n]*\n\s*+)*+"
        rb"(?:(?:drop|create)\s+table\s|insert\s+into\s|begin(?:\s+transaction)?\s*;|copy\s[^\n]*\sfrom\s+stdin\b)",
        "a dump of SQL: select the rows from the data base, and write the answer as CSV.",
    ),
    (
        rb"^(?:%[^\n]*\n|\s)*[A-Za-z]\w* *= *\[",
        "a script with matrices: save them, save('run.mat', 't', 'q', 'tau'), or write a table.",
    ),
)
"""How the text of files begins that is no table, and what to do."""
_TAR, _TAR_AT = b"ustar", 257
_WRITTEN = {"csv": "CSV", "parquet": "Parquet", "feather": "Feather", "jsonl": "JSON"}
_LOOKED_AT = 4096
"""Bytes: a logger may write some lines of its own before the first telegram."""


def format_of(path: Path) -> str:
    """Return the name of a file's format; "csv" for whatever is none of the others.

    Parameters
    ----------
    path : path
        Of several files, the first counts.

    Returns
    -------
    str
        One of `FORMATS`; "zip" is an archive of text files.

    Raises
    ------
    RecordingError
        For an empty file, or one of a format that is known and not read.
    """
    parts = split_path(path)
    if len(parts) > 1:
        return format_of(parts[0])
    content = TextContent(path)
    start = content.read_start(_LOOKED_AT)
    if not start:
        raise RecordingError("The file is empty.", title="Unreadable file")
    unmarked = "mat" if is_version_4(start) else None
    detected = next((name for first, name in _STARTS if start.startswith(first)), unmarked)
    # What was read is unpacked already: it shows what the compressed file holds.
    if content.compression is not None and (detected or START.search(start)):
        raise RecordingError(
            f"The file has the format {detected or 'rsi'} and is compressed with {content.compression}; only "
            "compressed text can be read directly. Unpack the file first.",
            title="Unreadable file",
        )
    # Both are archives of ZIP: their members tell NumPy's from one with text files.
    if detected == "npz":
        return "npz" if has_arrays(path) else "zip"
    if detected is not None:
        return detected
    _refuse_foreign(start)
    if json_records.START.search(start) or find_printed_kind(content) is not None:
        return "jsonl"
    return "rsi" if START.search(start) else "csv"


def _refuse_foreign(start: bytes) -> None:
    """Refuse files of formats that are known but not read, and say what to do."""
    if re.match(rb"\s*+(?:\xef\xbb\xbf\s*+)?<(?!\?xml)", start) and re.search(rb"<table\b", start, re.IGNORECASE):
        raise RecordingError(
            "The file is a table in HTML, which some programs write with the ending .xls: open it in a spreadsheet and "
            "save the sheet as CSV.",
            title="Unreadable file",
        )
    for begin, advice in _NOT_READ:
        if start.lstrip()[: len(begin)].lower() == begin.lower():
            raise RecordingError(f"The file is {advice}", title="Unreadable file")
    if start[_TAR_AT : _TAR_AT + len(_TAR)] == _TAR:
        raise RecordingError(
            "The file is an archive (.tar): unpack it, and give the file in it.", title="Unreadable file"
        )
    for pattern, advice in _TEXTS_NOT_READ:
        if re.match(pattern, start.removeprefix(codecs.BOM_UTF8)) and not START.search(start):
            raise RecordingError(f"The file is {advice}", title="Unreadable file")


def open_source(path: Path, file_format: str | None, rate: float | None = None) -> FileSource:
    """Open a user's file.

    Parameters
    ----------
    path : path
        Of one file, or of several that are one recording: q.csv+dq.csv+tau.csv.
    file_format : str, optional
        Told from its first bytes if not given.
    rate : float, optional
        Hz of the rows, if they have no time.

    Returns
    -------
    FileSource
        Its columns, with times joined and rows of several series brought together.

    Raises
    ------
    RecordingError
        If the file is empty, or not what it is said to be, or its name is no text.
    """
    if escape_surrogates(str(path)) != str(path):
        raise RecordingError(
            f"The file's name {escape_surrogates(path.name)!r} is not UTF-8; rename the file.", title="Unreadable file"
        )
    file = _open_source(path, file_format)
    # Times since the row before come after all repairs, and the stated rate last, which replaces any time.
    source = unwrap_counter(repair_times(_repair(file)))
    if rate is None and not any(is_time_name(name) for name in source.names):
        rate = file.stated_rate
        if rate is not None:
            source.own_remarks += (f"No column is a time: by the other data in the file the rate is {rate:g} Hz.",)
    return add_stated_time(source, rate)


_TIME = "t"


class StatedRateSource(FileSource):
    """A file whose rows are evenly spaced in time: `t` in s, from 0; it replaces a column of that name."""

    def __init__(self, source: FileSource, rate: float) -> None:
        self._source, self._rate = source, rate
        names = [name for name in source.names if name != _TIME]
        super().__init__([_TIME, *names], {**source.units, _TIME: "s"})
        self.sample_rows, self.texts = source.sample_rows, source.texts
        self.has_gaps, self.inner = source.has_gaps, source

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        needed = [name for name in columns if name != _TIME]
        first = 0
        # Some column has to be read even if only the time is wanted: it tells the number of rows.
        for batch in self._source.batches(needed or self._source.names[:1]):
            t = np.arange(first, first + batch.num_rows) / self._rate
            values = [from_numbers(t) if name == _TIME else batch.column(name) for name in columns]
            yield pa.RecordBatch.from_arrays(values, names=columns)
            first += batch.num_rows


_COUNTER = re.compile(
    r"(?:^|[^a-z])(?:ticks?|timer|counter|cnt|clock|time|timestamp|stamp|t)"
    r"(?:[ _.]*[\[(]?(?:(?:(?<![a-z])|(?<=tick))(?P<number>[1-9]\d*))? ?(?P<unit>s|ms|us|µs|ns)[\])]?)?$",
    re.IGNORECASE,
)
"""A counter of a timer, with what one count is: tick_100us; the number of t2 ms is that of a clock."""
_MODULI = (2.0**16, 2.0**24, 2.0**32)
"""Where counters of a timer begin again."""
_UNEVEN = 1.5
"""Factor by which a step across a full count differs from the usual one at most: other falls are those of new runs."""


@dataclass
class CounterUnwrap:
    """Adds to a counter what it has lost where it began again, block by block."""

    overflows: int = 0
    falls: int = 0
    """Places where it goes back by more than rows that were exchanged."""
    moduli: set[float] = field(default_factory=set)
    largest: float = 0.0
    is_whole: bool = True
    """Whether all counts are whole numbers from 0 on."""
    is_rising: bool = True
    _added: float = 0.0
    _last: float = np.nan
    _step: float = 0.0

    @property
    def begins_again(self) -> bool:
        """Whether most falls are overflows, all at one full count that is never exceeded."""
        return (
            self.is_whole
            and len(self.moduli) == 1
            and max(self.moduli) > self.largest
            and (2 * self.overflows > self.falls)
        )

    @property
    def may_begin_again(self) -> bool:
        """Whether further rows may still show that it does."""
        return self.is_whole and self.largest < _MODULI[-1]

    def add(self, counts: FloatArray) -> FloatArray:
        """Return the next counts (m,), which go on; missing ones are NaN."""
        unwrapped = counts.copy()
        is_finite = np.isfinite(counts)
        values = counts[is_finite]
        if not len(values):
            return unwrapped
        before = np.concatenate([[self._last], values[:-1]])
        steps = values - before
        if not self._step and (steps > 0.0).any():
            self._step = float(np.median(steps[steps > 0.0]))
        # Whole numbers: even steps differ by a count.
        shortest = min(self._step / _UNEVEN, self._step - 1.0)
        longest = max(self._step * _UNEVEN, self._step + 1.0) if self._step else 0.0
        lost = np.zeros(len(values))
        for modulus in _MODULI:
            goes_on = steps + modulus
            is_full = (before < modulus) & (steps < 0.0) & (goes_on >= shortest) & (goes_on <= longest)
            lost[is_full] = modulus
        self.overflows += int(np.count_nonzero(lost))
        self.falls += int(np.count_nonzero((lost > 0.0) | (steps < -FEWEST_STEPS * self._step)))
        self.moduli |= set(lost[lost > 0.0].tolist())
        self.largest = max(self.largest, float(values.max()))
        self.is_whole = self.is_whole and bool((values == np.rint(values)).all() and values.min() >= 0.0)
        self.is_rising = self.is_rising and not (steps <= 0.0).any()
        unwrapped[is_finite] = values + self._added + np.cumsum(lost)
        self._added, self._last = self._added + float(lost.sum()), float(values[-1])
        return unwrapped


class CounterTimeSource(FileSource):
    """A file stamped by the counter of a timer, which may begin again: `t` goes on, in s where its unit is known.

    Parameters
    ----------
    source : FileSource
        The file.
    counter : str
        Its column.
    factor : float
        s of a count, or 1.
    unit : str
        Of the time then.
    begins_again : bool
        Whether it does, at a full count.
    """

    def __init__(self, source: FileSource, counter: str, factor: float, unit: str, begins_again: bool) -> None:
        self._source, self._counter, self._factor, self._begins_again = source, counter, factor, begins_again
        names = [name for name in source.names if name not in (_TIME, counter)]
        units = {name: own for name, own in source.units.items() if name != counter}
        super().__init__([_TIME, *names], {**units, **({_TIME: unit} if unit else {})})
        self.sample_rows, self.texts = source.sample_rows, source.texts
        self.has_gaps, self.inner, self.clocks = source.has_gaps, source, source.clocks
        again = ", from 0 again where it is full: t is its time, which goes on." if begins_again else ": t is its time."
        self.own_remarks = (f"{counter} counts{again}",)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        needed = [self._counter if name == _TIME else name for name in columns]
        unwrap, first_row = CounterUnwrap(), 0
        for batch in self._source.batches(list(dict.fromkeys(needed))):
            values = {name: batch.column(name) for name in needed}
            if _TIME in columns and batch.num_rows:
                counts = to_float_column(batch, self._counter, first_row)
                goes_on = unwrap.add(counts) if self._begins_again else counts
                values[_TIME] = from_numbers(self._factor * goes_on)
            yield pa.RecordBatch.from_arrays([values[name] for name in columns], names=columns)
            first_row += batch.num_rows


def unwrap_counter(source: FileSource) -> FileSource:
    """Return the file with a time that goes on, if a counter stamps it that begins again; else the same object."""
    matches = {name: match for name in source.names if (match := _COUNTER.search(name)) and name not in source.texts}
    counters = _read_counters(source, list(matches))
    again = [name for name, counter in counters.items() if counter.begins_again]
    # A time that goes on beside it says more than a counter, unless that counts rows.
    others = [name for name, counter in counters.items() if counter.is_rising and is_time_name(name)]
    alone = [name for name in counters if len(matches) == 1 and matches[name]["number"] and counters[name].is_whole]
    name = next(iter(alone if others or not again else again), None)
    if name is None:
        return source
    number, unit = matches[name]["number"], (matches[name]["unit"] or source.units.get(name) or "").casefold()
    scale = _COUNTS.get(unit)
    factor = 1.0 if scale is None else scale * float(number or 1)
    return CounterTimeSource(source, name, factor, "" if scale is None else "s", name in again)


def _read_counters(source: FileSource, names: list[str]) -> dict[str, CounterUnwrap]:
    """Return what the columns count: by all rows, as long as one of them may be a counter that begins again."""
    counters, first_row = {name: CounterUnwrap() for name in names}, 0
    for batch in source.batches(names) if names else ():
        for name, counter in counters.items():
            counter.add(to_float_column(batch, name, first_row))
        first_row += batch.num_rows
        if not any(counter.may_begin_again for counter in counters.values()):
            break
    return {name: counter for name, counter in counters.items() if counter.largest > 0.0}


_COUNTS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}


def add_stated_time(source: FileSource, rate: float | None) -> FileSource:
    """Return the file with the time that a stated rate in Hz gives its rows; the same object without a rate."""
    return source if rate is None else StatedRateSource(source, rate)


def _open_source(path: Path, file_format: str | None) -> FileSource:
    parts = split_path(path)
    if len(parts) > 1:
        return _join_files(path, parts)
    detected = format_of(path)
    if file_format == "parquet" and detected == "csv":
        return ParquetFileSource(path)  # which says what is wrong with it
    # MATLAB's files from version 7.3 on are HDF5.
    if file_format not in (None, detected) and (detected, file_format) != ("hdf5", "mat"):
        raise RecordingError(
            f"The file is {_WRITTEN.get(detected, detected)}, not {_WRITTEN.get(file_format, file_format)}; say "
            f'"format": "{detected}".',
            pointer="/format",
        )
    if detected in ("parquet", "feather"):
        return ParquetFileSource(path) if detected == "parquet" else FeatherFileSource(path)
    if detected in ("csv", "jsonl"):
        return open_text(TextContent(path))
    if detected == "zip":
        return _join_files(path, parts)
    return _open_foreign(path, detected)


def _join_files(path: Path, parts: list[Path]) -> FileSource:
    """Open the files of a recording in several files, or those in an archive."""
    for part in parts:
        if len(parts) > 1 and format_of(part) == "zip":
            raise RecordingError(
                f"{part.name} is an archive: unpack it, and join the files in it.", title="Unreadable file"
            )
    return open_joined_files(
        path, parts, lambda content: _repair(open_text(content)), lambda part: _repair(_open_source(part, None))
    )


def _repair(file: FileSource) -> FileSource:
    """Return a file as a table with one time and a column for each signal.

    Each wrapper repairs one thing: objects of JSON in cells; words, since times
    may be among them; then signals one below another;
    channels with their own times; split stamps; rows of several series.
    """
    table = join_stacked_series(read_word_cells(json_records.expand_json_cells(file)))
    return join_sparse_rows(join_split_stamps(join_own_clocks(table)))


def open_text(content: TextContent) -> FileSource:
    """Open text: JSON, or a table.

    Raises
    ------
    RecordingError
        If it cannot be read.
    """
    if json_records.START.search(content.read_start(_LOOKED_AT)):
        return read_marked_gaps(json_records.open_json(content))
    kind = find_printed_kind(content)
    if kind is not None:
        return read_marked_gaps(json_records.open_json(rewrite_as_json(content, kind)))
    table, remarks = rearrange_table(content)
    source = CsvFileSource(table)
    source.own_remarks = remarks
    return read_marked_gaps(source)


def _open_foreign(path: Path, name: str) -> FileSource:
    """Open a file of a format that is neither CSV nor Parquet.

    Raises
    ------
    RecordingError
        For a file that cannot be read, or a package that reads it and is not installed.
    """
    try:
        # Each reader is loaded when it is needed: its package may not be installed.
        if name in ("npy", "npz"):
            from dynident.recordings.formats.numpy_files import open_numpy

            return open_numpy(path, name)
        if name == "mat":
            return open_matlab(path)
        if name == "hdf5":
            from dynident.recordings.formats.hdf5 import open_hdf5

            return open_hdf5(path)
        if name in ("rsi", "diadem"):
            return open_telegrams(path) if name == "rsi" else open_data_set(path)
        from dynident.recordings.formats.bags import open_bag

        return open_bag(path, name)
    except ModuleNotFoundError as missing:
        raise RecordingError(
            f"Reading files of the format {name} needs the package {missing.name}, which is not installed: pip "
            "install 'dynident[formats]'. Or export the file as CSV or Parquet.",
            pointer="/format",
            title="Not installed",
        ) from missing
