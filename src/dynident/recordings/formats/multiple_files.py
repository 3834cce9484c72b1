"""One recording in several files or an archive, joined by time or row by row."""

from __future__ import annotations

import io
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path, PurePosixPath
from typing import IO
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import batch_from_arrays, from_numbers
from dynident.recordings.cells_without_numbers import make_counted_names
from dynident.recordings.file_names_and_digests import MOST_FILES
from dynident.recordings.file_size_limits import (
    MOST_TEXT,
    TITLE,
    check_columns,
    check_unpacked,
    choose_block_rows,
    make_damaged_error,
)
from dynident.recordings.file_source import FileSource, to_float_column
from dynident.recordings.formats.array_files import RUN_WORDS
from dynident.recordings.formats.text_streams import ProducedStream, TextContent
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.sample_series_join import JoinedSamples, SampleSeries, TimeJoin
from dynident.recordings.time_columns import is_time_name

_LOOKED_AT = 1000
_FOREIGN = {
    "[Content_Types].xml": "an Excel workbook (.xlsx): save the sheet as CSV.",
    "content.xml": "a spreadsheet (.ods): save the sheet as CSV.",
    ".zgroup": "an array store of Zarr: write its arrays with np.savez('run.npz', t=t, q=q, tau=tau).",
    "zarr.json": "an array store of Zarr: write its arrays with np.savez('run.npz', t=t, q=q, tau=tau).",
    "data.pkl": "one of PyTorch, with a pickle in it, which may run programs and is never opened: save the arrays with "
    "np.savez('run.npz', t=t, q=q, tau=tau), or the table as CSV or Parquet.",
}
"""Members of archives that are no recordings, and what these are."""
_BROKEN = (BadZipFile, zlib.error, OSError, EOFError, RuntimeError, NotImplementedError, ValueError)
"""What Python's reader of archives raises of damaged ones; of what is encrypted, RuntimeError."""

Named = tuple[str, FileSource]


@dataclass(frozen=True, eq=False)
class _FilePart:
    """One file: its column of time with that column's name, its other columns by their names, its usual step.

    `span` holds the first and the last time of its first block of rows.
    """

    name: str
    source: FileSource
    time: str | None
    time_name: str
    columns: dict[str, str]
    step: float
    span: tuple[float, float]

    def read_blocks(self, columns: Sequence[str]) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield times (m,), and values (m, c) of the named columns."""
        own = [self.columns[name] for name in columns]
        probe = self.time or (own or list(self.columns.values()))[0]
        first = 0
        for batch in self.source.batches(list(dict.fromkeys([probe, *own]))):
            t = to_float_column(batch, probe, first)
            values = np.empty((len(t), len(own)))
            for place, column in enumerate(own):
                values[:, place] = to_float_column(batch, column, first)
            yield t, values
            first += len(t)


class JoinedFiles(FileSource):
    """The columns of several files; `t` is the time of the one whose rows are used."""

    def __init__(self, files: Sequence[Named]) -> None:
        if len(files) > MOST_FILES:
            raise RecordingError(
                f"The recording is in {len(files)} files; at most {MOST_FILES} are joined.", title=TITLE
            )
        self._parts = _make_parts(files)
        self._places = {name: part for part in self._parts for name in part.columns}
        timed = [part for part in self._parts if part.time is not None]
        # Files are joined by time only if all of them have one: a file without would not know where to belong.
        self._by_time = len(timed) == len(self._parts)
        if self._by_time:
            _check_clocks(self._parts)
        # A file of nothing but times is the clock of all others.
        self._main = min(timed, key=lambda part: part.step) if self._by_time else next(iter(timed), self._parts[0])
        names = list(self._places)
        self._time = self._main.time_name
        units = {
            name: unit for name, part in self._places.items() if (unit := part.source.units.get(part.columns[name]))
        }
        if self._main.time is not None:
            names = [self._time, *names]
            if self._main.time in self._main.source.units:
                units[self._time] = self._main.source.units[self._main.time]
        super().__init__(names, units)
        how = "interpolated at its times" if self._by_time else "joined to it row by row"
        others = ", ".join(part.name for part in self._parts if part is not self._main)
        self.own_remarks = (f"The rows are those of {self._main.name}; {others} {how}.",)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        yield from self._read_at_times(columns) if self._by_time else self._read_rows(columns)

    def _select_files(self, columns: list[str]) -> list[tuple[_FilePart, list[str]]]:
        """Return the files that are read, with the requested columns of each; the main file always."""
        columns_of = [(part, [name for name in columns if self._places.get(name) is part]) for part in self._parts]
        return [(part, own) for part, own in columns_of if own or part is self._main]

    def _read_at_times(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        parts = self._select_files(columns)
        size = choose_block_rows(len(columns))
        join = TimeJoin({part.name: SampleSeries(own, part.step) for part, own in parts}, self._main.name, size)
        streams = {part.name: part.read_blocks(own) for part, own in parts}
        names = {part.name: own for part, own in parts}
        latest = dict.fromkeys(streams, -np.inf)
        while streams:
            # The file that is farthest behind is read next, so that little has to wait in memory.
            behind = min(streams, key=lambda name: latest[name])
            block = next(streams[behind], None)
            if block is None:
                del streams[behind]
                continue
            t, values = block
            has_time = np.isfinite(t)
            if has_time.any():
                join.add(behind, t[has_time], names[behind], values[has_time])
                latest[behind] = float(t[has_time][-1])
            if join.is_full:
                yield from self._make_batch(join.rows(), names, columns)
        yield from self._make_batch(join.rows(last=True), names, columns)

    def _make_batch(
        self, joined: JoinedSamples, names: dict[str, list[str]], columns: list[str]
    ) -> Iterator[pa.RecordBatch]:
        if not len(joined.times):
            return
        values = {self._time: joined.times}
        for part, own in names.items():
            values |= {column: joined.values[part][:, place] for place, column in enumerate(own)}
        yield batch_from_arrays(values, columns)

    def _read_rows(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        parts = self._select_files(columns)
        streams = [part.read_blocks(own) for part, own in parts]
        waiting = [(np.empty(0), np.empty((0, len(own)))) for _, own in parts]
        n_rows = 0
        while True:
            ended = []
            for place, stream in enumerate(streams):
                if not len(waiting[place][0]):
                    # At its end a file keeps the empty block, which marks it below.
                    waiting[place] = next(stream, waiting[place])
                ended.append(not len(waiting[place][0]))
            if any(ended):
                if not all(ended):
                    place = ended.index(False)
                    short, long = parts[ended.index(True)][0].name, parts[place][0].name
                    n_long = n_rows + len(waiting[place][0]) + sum(len(t) for t, _ in streams[place])
                    times = n_long // n_rows if n_rows and n_long % n_rows == 0 else 0
                    flat = f" {n_long} is {times} times {n_rows}: write {times} values a row." if times else ""
                    raise RecordingError(
                        f"{short} ends after {n_rows} rows, but {long} has more: files without their own time column "
                        f"are joined row by row and must have equally many rows.{flat}",
                        title="Different lengths",
                    )
                return
            # Blocks of different files have different lengths: as many rows as all of them have.
            count = min(len(t) for t, _ in waiting)
            values: dict[str, FloatArray] = {}
            for (part, own), (t, table) in zip(parts, waiting, strict=True):
                values |= {name: table[:count, place] for place, name in enumerate(own)}
                if part is self._main and part.time is not None:
                    values[self._time] = t[:count]
            yield batch_from_arrays(values, columns)
            waiting = [(t[count:], table[count:]) for t, table in waiting]
            n_rows += count


def _make_parts(files: Sequence[Named]) -> list[_FilePart]:
    """Return the files with unique column names: one that several files have gets the file's name in front."""
    stems = _name_apart([file for file, _ in files])
    clocks = [_count_leading_clocks(source) for _, source in files]
    # One file alone may begin with a joint that moves evenly; that all of them do means that all have the time there.
    n_clocks = clocks[0] if len(set(clocks)) == 1 else 0
    own = [_name_columns(stem, source, n_clocks) for stem, (_, source) in zip(stems, files, strict=True)]
    times = [next(filter(is_time_name, names), None) for names in own]
    called = [name for names, time in zip(own, times, strict=True) for name in names if name != time]
    base_names = [PurePosixPath(file).name for file, _ in files]
    parts: list[_FilePart] = []
    for names, time, stem, base_name, (file, source) in zip(own, times, stems, base_names, files, strict=True):
        columns = {
            name if called.count(name) == 1 else f"{stem}.{name}": column
            for name, column in names.items()
            if name != time
        }
        own_time = None if time is None else names[time]
        twice = next((name for part in parts for name in part.columns if name in columns), None)
        if twice is not None:
            raise RecordingError(f"Column {twice} occurs twice, in files of the same name.", pointer=twice, title=TITLE)
        # Messages name a file without its folders, where that is enough to tell it from the others.
        shown = base_name if base_names.count(base_name) == 1 else file
        parts.append(_FilePart(shown, source, own_time, time or "", columns, *_measure_times(source, own_time)))
    check_columns(sum(len(part.columns) for part in parts))
    return parts


def _name_apart(files: Sequence[str]) -> list[str]:
    """Return the names of files without their endings.

    Files that differ by their endings alone, run.q and run.tau, have these; files of one name, encoders/data.log, have
    their folder's.
    """
    paths = [PurePosixPath(file) for file in files]
    stems, names = ([getattr(path, part) for path in paths] for part in ("stem", "name"))

    def name_file(path: PurePosixPath) -> str:
        if stems.count(path.stem) == 1:
            return path.stem
        if names.count(path.name) == 1:
            return path.suffix.removeprefix(".")
        return path.stem if path.parent.name in ("", "..") else path.parent.name

    return [name_file(path) for path in paths]


def _name_columns(stem: str, source: FileSource, n_clocks: int) -> dict[str, str]:
    """Return the file's columns by their names; a file without a line of names is called after itself.

    Of its first `n_clocks` columns the last is the time, and those before it count the rows.
    """
    if not _is_nameless(source):
        return {name: name for name in source.names}
    counters = [f"{stem}_row{number + 1}" for number in range(n_clocks - 1)]
    time = ["t"] if n_clocks else []
    n_others = len(source.names) - n_clocks
    called = (stem,) if n_others == 1 else make_counted_names(stem, n_others)
    return dict(zip((*counters, *time, *called), source.names, strict=True))


def _is_nameless(source: FileSource) -> bool:
    return source.names == list(make_counted_names("column", len(source.names)))


_MOST_CLOCKS, _UNEVEN = 2, 5.0
"""Columns of time, or of row numbers, in front of the signals; and their largest step over the usual one."""


def _count_leading_clocks(source: FileSource) -> int:
    """Return how many of the first columns of a file without names run forward evenly, in the rows looked at."""
    if not _is_nameless(source) or len(source.names) <= _MOST_CLOCKS:
        return 0
    names = source.names[:_MOST_CLOCKS]
    batch = next(iter(source.batches(names)), None)
    for number, name in enumerate(names if batch is not None else ()):
        steps = np.diff(to_float_column(batch, name, 0)[:_LOOKED_AT])
        if len(steps) < _FEWEST_STEPS or not (steps > 0.0).all() or steps.max() > _UNEVEN * np.median(steps):
            return number
    return len(names)


_FEWEST_STEPS = 100


def _measure_times(source: FileSource, time: str | None) -> tuple[float, tuple[float, float]]:
    """Return the usual step of a file's time, and the span of its first block of rows."""
    if time is None:
        return 0.0, (0.0, 0.0)
    batch = next(iter(source.batches([time])), None)
    t = np.empty(0) if batch is None else to_float_column(batch, time, 0)
    t = t[np.isfinite(t)]
    steps = np.diff(t[:_LOOKED_AT])
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else 1.0, (float(t.min()), float(t.max())) if len(t) else (0.0, 0.0)


_APART = 100.0
"""Spans of time between two files beyond which they cannot be parts of one recording."""


def _check_clocks(parts: Sequence[_FilePart]) -> None:
    """Refuse files whose times do not belong together: one since 1970, the other since its own start; ms beside s."""
    for pair in combinations(parts, 2):
        # The first block of a file with many columns is short: what its times seem by that is confirmed by all rows.
        if _find_clash(*pair) and (clash := _find_clash(*map(_measure_whole_span, pair))):
            raise RecordingError(clash, title="Different clocks")


def _find_clash(first: _FilePart, second: _FilePart) -> str | None:
    """Return why the times of two files do not belong together, by their spans; None where they may."""
    (begin, end), (other_begin, other_end) = first.span, second.span
    longest = max(end - begin, other_end - other_begin)
    gap = max(begin - other_end, other_begin - end)
    if longest > 0.0 and gap > _APART * longest:
        return (
            f"{first.name} begins at {begin:.10g} and {second.name} at {other_begin:.10g}: their clocks differ, so "
            "they cannot be joined by time. Write both with one clock, subtracting from each the time at which the "
            "recording began; or leave the time out of one, if their rows belong together one by one."
        )
    shortest = min(end - begin, other_end - other_begin)
    ratio = longest / shortest if shortest > 0.0 else 1.0
    steps = max(first.step, second.step) / max(min(first.step, second.step), 1e-300)
    if ratio > _OTHER_UNIT and steps > _OTHER_UNIT:
        return (
            f"{first.name} is {end - begin:.4g} long by its time, and {second.name} {other_end - other_begin:.4g}: "
            "their times seem to be in different units, such as s and ms. Write both in s."
        )
    return None


def _measure_whole_span(part: _FilePart) -> _FilePart:
    """Return the file with the first and the last time of all of its rows."""
    begin, end = part.span
    for t, _ in part.read_blocks(()):
        known = t[np.isfinite(t)]
        begin, end = min(begin, known.min(initial=begin)), max(end, known.max(initial=end))
    return replace(part, span=(float(begin), float(end)))


_OTHER_UNIT = 500.0
"""Ratio of both steps and spans of time from which two files count in different units."""


def open_joined_files(
    path: Path,
    paths: Sequence[Path],
    open_text: Callable[[TextContent], FileSource],
    open_file: Callable[[Path], FileSource],
) -> FileSource:
    """Open the files of a recording, or those in an archive (.zip) if `path` is the only one.

    Parameters
    ----------
    path : path
        Where the file, or the first of several, lies.
    paths : sequence of path
        The files that `path` names.
    open_text : function
        Opens one of them in an archive.
    open_file : function
        Opens one of them on the disk.

    Returns
    -------
    FileSource
        The columns of all of them.

    Raises
    ------
    RecordingError
        For files that cannot be read, or not be joined.
    """
    if len(paths) > 1:
        return _join_or_chain([(file.as_posix(), open_file(file)) for file in paths])
    try:
        members = _list_members(path)
    except RecordingError:
        raise
    except _BROKEN as error:
        raise make_damaged_error("ZIP", error) from error
    sources = [(name, open_text(TextContent(path, _make_opener(path, name)))) for name in members]
    return sources[0][1] if len(sources) == 1 else _join_or_chain(sources)


def _join_or_chain(files: Sequence[Named]) -> FileSource:
    """Return files that are runs, run1 and run2 of the same columns, one behind another; others side by side."""
    # Words and numbers take turns; the one number that differs counts what the word before it says.
    split_stems = [re.split(r"(\d+)", PurePosixPath(file).stem) for file, _ in files]
    first = split_stems[0]
    counting = [place for place, parts in enumerate(zip(*split_stems, strict=False)) if len(set(parts)) > 1]
    are_runs = (
        len({len(parts) for parts in split_stems}) == 1
        and len(counting) == 1
        and counting[0] % 2 == 1
        and len({parts[counting[0]] for parts in split_stems}) == len(files)
        and RUN_WORDS.search("".join(first[: counting[0]])) is not None
        and len({tuple(source.names) for _, source in files}) == 1
        and _SEGMENT not in files[0][1].names
    )
    return ChainedFiles(sorted(files, key=_list_numbers)) if are_runs else JoinedFiles(files)


def _list_numbers(file: Named) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", PurePosixPath(file[0]).stem)]


_SEGMENT = "segment"


class ChainedFiles(FileSource):
    """Files of the same columns that are runs: one behind another, with the number of the run in each row.

    Parameters
    ----------
    files : sequence of (str, FileSource)
        Their names, and the files.
    """

    def __init__(self, files: Sequence[Named]) -> None:
        self._sources = [source for _, source in files]
        first = self._sources[0]
        super().__init__([*first.names, _SEGMENT], first.units)
        self.sample_rows, self.texts = first.sample_rows, first.texts
        self.has_gaps = any(source.has_gaps for source in self._sources)
        self.own_remarks = (
            f"{', '.join(PurePosixPath(name).name for name, _ in files)} have the same columns: they are read as runs, "
            "one after the other, each as a segment of its own.",
        )

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        stored = [name for name in columns if name != _SEGMENT] or self.names[:1]
        for number, source in enumerate(self._sources):
            for batch in source.batches(stored):
                runs = from_numbers(np.full(batch.num_rows, float(number)))
                yield pa.RecordBatch.from_arrays(
                    [runs if name == _SEGMENT else batch.column(stored.index(name)) for name in columns], names=columns
                )


def _is_of_the_system(name: str) -> bool:
    """Return whether a member of an archive is a note of the operating system, such as .DS_Store."""
    return name.startswith("__MACOSX/") or name.rpartition("/")[2].startswith(".")


def has_arrays(path: Path) -> bool:
    """Return whether an archive is NumPy's; True for a damaged one as well, so that its reader reports it."""
    try:
        with ZipFile(path) as archive:
            names = archive.namelist()
    except _BROKEN:
        return True
    members = {PurePosixPath(name).name for name in names}
    for member in _FOREIGN.keys() & members:
        raise RecordingError(f"The file is {_FOREIGN[member]}", title=TITLE)
    return not names or any(name.endswith(".npy") for name in names)


def _list_members(path: Path) -> list[str]:
    with ZipFile(path) as archive:
        # macOS puts a file of attributes beside each of the user's; empty files hold no columns.
        members = [
            member
            for member in archive.infolist()
            if not member.is_dir() and not _is_of_the_system(member.filename) and member.file_size
        ]
    if not 1 <= len(members) <= MOST_FILES:
        raise RecordingError(
            f"The archive contains {len(members)} files; a recording has at most {MOST_FILES}.", title=TITLE
        )
    # Before anything is unpacked: a small archive may claim, and hold, gigabytes.
    check_unpacked(sum(member.file_size for member in members), path.stat().st_size, MOST_TEXT)
    for member in members:
        if member.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
            raise ValueError(f"{member.filename} is compressed by a method that is not supported")
    return [member.filename for member in members]


def _make_opener(path: Path, name: str) -> Callable[[], IO[bytes]]:
    return lambda: io.BufferedReader(_ArchiveMember(path, name), 1 << 18)


class _ArchiveMember(ProducedStream):
    """A file in an archive; no more of it is unpacked than the archive says."""

    def __init__(self, path: Path, name: str) -> None:
        super().__init__()
        self._name = name
        try:
            self._archive = ZipFile(path)
            self._file = self._archive.open(name)
        except _BROKEN as error:
            raise self._broken_member_error(error) from error

    def _broken_member_error(self, error: Exception) -> RecordingError:
        return RecordingError(f"{self._name} in the archive cannot be read: {error}", title=TITLE)

    def read_part(self, size: int) -> bytes:
        """Unpack the next bytes."""
        try:
            return self._file.read(size)
        except _BROKEN as error:
            raise self._broken_member_error(error) from error

    def close(self) -> None:
        """Close the archive."""
        self._file.close()
        self._archive.close()
        super().close()
