"""What MAT, HDF5 and NumPy readers share: which arrays are columns, read part by part."""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from types import MappingProxyType
from typing import IO, Any

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import from_numbers
from dynident.recordings.file_size_limits import MOST_UNPACKED, TITLE, check_columns, choose_block_rows
from dynident.recordings.file_source import FileSource
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.time_columns import describe_foreign_clock, is_time_name

_NONE: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class ArrayPlace:
    """Where an array lies: the file, the first byte, how numbers are stored, and which axis runs first."""

    file: IO[bytes]
    start: int
    kind: np.dtype[Any]
    shape: tuple[int, ...]
    by_columns: bool

    @property
    def end(self) -> int:
        """The first byte behind the array."""
        return self.start + self.kind.itemsize * math.prod(self.shape)

    def to_array(self, name: str, field: str | None = None) -> StoredArray:
        """Return the array under a name; `field` is one of its records', if it holds some."""
        inner = () if field is None else self.kind[field].shape
        shape = (*self.shape, *inner)

        def read(first: int, last: int, axis: int) -> FloatArray:
            if axis < len(self.shape):
                values = self._read_rows(first, last, axis)
                return np.asarray(values if field is None else values[field], dtype=np.float64)
            # The rows run within the records, of which there are fewer than rows.
            records = self._read_rows(0, self.shape[0], 0)
            return np.array(records[field][:, first:last].T, dtype=np.float64)

        return StoredArray(name, shape, read)

    def _read_rows(self, first: int, last: int, axis: int) -> np.ndarray[Any, Any]:
        """Return the part from `first` to `last` along an axis, which becomes the first axis."""
        lines = self.shape[::-1] if self.by_columns else self.shape
        width = math.prod(lines[1:])
        # Along the slow axis the rows are contiguous; along the other one each line is read in a piece of its own.
        if axis == (len(self.shape) - 1 if self.by_columns else 0):
            return self._read_numbers(first * width, (last - first) * width).reshape(last - first, *lines[1:])
        return np.stack([self._read_numbers(line * width + first, last - first) for line in range(lines[0])], axis=1)

    def read_cells(self) -> list[object]:
        """Return the cells of a short array of one axis."""
        return list(self._read_numbers(0, self.shape[0]).tolist())

    def _read_numbers(self, first: int, count: int) -> np.ndarray[Any, Any]:
        # Reading at a place moves no position, so that all arrays of a file can share it.
        data = os.pread(self.file.fileno(), count * self.kind.itemsize, self.start + first * self.kind.itemsize)
        return np.frombuffer(data, dtype=self.kind, count=count)


MOST_WORDS = 64
"""Words of a list that may name the joints."""


def read_words(cells: Iterable[object]) -> tuple[str, ...]:
    """Return cells of text as words; none where two are the same, or one is empty."""
    words = tuple(cell.decode(errors="replace") if isinstance(cell, bytes) else str(cell) for cell in cells)
    return words if all(words) and len(set(words)) == len(words) > 1 else ()


def count_name(name: str, number: int) -> str:
    """Return the name of one of several things that have one name: q2, or q1_2 behind a number."""
    return f"{name}_{number}" if name[-1:].isdecimal() else f"{name}{number}"


FEWEST_ROWS = 8
"""Arrays that are shorter both ways are settings, not signals."""

_PERIOD = re.compile(r"ts|dt|delta_?t|(sampl\w*_?)?(time_?step|period)|sampl\w*_?time", re.IGNORECASE)
_RATE = re.compile(r"fs|f_?s\w*_?hz|hz|(sampl\w*_?)?(rate|freq|frequency)(_?hz)?", re.IGNORECASE)
"""Names of single numbers that say how far apart the rows are, in s, and how many a second there are."""
_SLOWEST, _FASTEST = 1.0, 1e5
"""Hz that are believed: ms taken for s would be slower."""


@dataclass(frozen=True, eq=False)
class StoredArray:
    """One array of a file: its name, its shape (one or two axes), and the function that reads a part of it.

    `read(first, last, axis)` takes the axis that the rows run along, and returns (rows, width) or (rows,). `label` is
    what the file says that the array is called, if it does.
    """

    name: str
    shape: tuple[int, ...]
    read: Callable[[int, int, int], FloatArray]
    label: str = ""


@dataclass(frozen=True, eq=False)
class _ArrayColumn:
    stored: StoredArray
    axis: int
    index: int


class ArrayFileSource(FileSource):
    """The arrays of a file as columns: an array q of m x 6 is q1 … q6, whichever way it lies.

    Parameters
    ----------
    arrays : sequence of StoredArray
        The arrays of numbers.
    words : sequence of tuple of str
        Lists of different words in the file: one that is as long as an array is wide names its columns.
    unread : mapping of str to str
        Variables that cannot be read, and what to do about each.
    """

    def __init__(
        self, arrays: Sequence[StoredArray], words: Sequence[tuple[str, ...]] = (), unread: Mapping[str, str] = _NONE
    ) -> None:
        self.stated_rate = _find_stated_rate(arrays)
        deep = next((array for array in arrays if len(array.shape) > 2), None)
        names = _distinguish([array.name for array in arrays])
        arrays = [replace(array, name=name) for array, name in zip(arrays, names, strict=True)]
        arrays = [array for array in arrays if 1 <= len(array.shape) <= 2 and min(array.shape) > 0]
        arrays = _split_timed_pairs(arrays)
        labelled = _name_by_labels(arrays)
        runs, left_out = _find_runs(labelled)
        if runs:
            labelled = _chain_runs(runs)
            self.own_remarks = (
                f"The file holds {len(runs)} runs with the same signals: they are read one after the other, each as a "
                f"segment of its own{_describe_left_out(left_out, 'not every run has a value of in each row')}.",
            )
        else:
            joined, self.own_remarks = _join_clocks(arrays)
            labelled = _name_by_labels(joined) if joined else labelled
        arrays = [array for array in labelled if max(array.shape) >= FEWEST_ROWS]
        if not arrays:
            raise RecordingError(_describe_no_arrays(deep, unread), pointer=next(iter(unread), ""), title=TITLE)
        self.own_remarks += (*unread.values(),)[:1]
        # Arrays do not say which of their axes is time: it is the length that they share.
        self._length = _find_length(arrays)
        # The common group is stripped of names before arrays of other lengths, settings mostly, are left out.
        prefix = _find_prefix([array.name for array in arrays])
        arrays = [array for array in arrays if self._length in array.shape]
        check_columns(sum(math.prod(array.shape) // self._length for array in arrays))
        places: list[tuple[str, _ArrayColumn]] = []
        vectors = {array.name[len(prefix) :] for array in arrays if math.prod(array.shape) == self._length}
        for array in arrays:
            axis = array.shape.index(self._length)
            width = array.shape[1 - axis] if len(array.shape) == 2 else 1
            name = array.name[len(prefix) :] or "column"
            named = {listed for listed in words if len(listed) == width > 1}
            parts = [f"_{word}" for word in named.pop()] if len(named) == 1 else [*map(str, range(1, width + 1))]
            # Beside a vector q1 the columns of q are q_1 ….
            joint = "_" if name[-1].isdecimal() or vectors.intersection(f"{name}{part}" for part in parts) else ""
            places += [
                (name if width == 1 else f"{name}{joint}{parts[index]}", _ArrayColumn(array, axis, index))
                for index in range(width)
            ]
        columns = _distinguish([column for column, _ in places])
        self._places = {column: place for column, (_, place) in zip(columns, places, strict=True)}
        super().__init__(list(self._places))

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        # Arrays of several columns are read once for each block, not once for each column.
        step = choose_block_rows(len(self._places))
        for first in range(0, self._length, step):
            last = min(first + step, self._length)
            blocks: dict[int, FloatArray] = {}
            values = []
            for column in columns:
                place = self._places[column]
                whole = blocks.get(id(place.stored))
                if whole is None:
                    whole = blocks[id(place.stored)] = _read_rows(place, first, last)
                values.append(from_numbers(np.asarray(whole[:, place.index], dtype=np.float64)))
            yield pa.RecordBatch.from_arrays(values, names=columns)


RUN_WORDS = re.compile(
    r"(?:^|[^a-z])(?:runs?|demos?|trials?|episodes?|ep|exp|experiments?|traj|trajector(?:y|ies)|segments?|seq|"
    r"rep|repetitions?|tests?|takes?|rollouts?|meas\w*|rec|recordings?)[^a-z]*$",
    re.IGNORECASE,
)
"""Words before a number that say that it counts runs, and not arms or joints."""


def _find_runs(arrays: Sequence[StoredArray]) -> tuple[list[dict[str, StoredArray]], list[str]]:
    """Return the arrays of each run by their signals, where groups of arrays are runs, and the signals of some only.

    Groups are numbered, and each has arrays of the same names, one of them for several joints. Of different lengths
    they are runs; of one length they may also be arms, unless a word such as "demo" says what is counted.
    """
    groups: dict[str, dict[int, dict[str, StoredArray]]] = {}
    for array in arrays:
        for match in re.finditer(r"\d+(?=[./_])", array.name):
            head, tail = array.name[: match.start()], array.name[match.end() :]
            groups.setdefault(head, {}).setdefault(int(match[0]), {})[tail] = array
    for head, numbered in groups.items():
        runs = [
            {tail: array for tail, array in numbered[number].items() if max(array.shape) >= FEWEST_ROWS}
            for number in sorted(numbered)
        ]
        runs = [run for run in runs if run]
        common = set.intersection(*(set(run) for run in runs)) if len(runs) > 1 else set()
        lengths = [_find_length(list(run.values())) for run in runs]
        chained = [
            tail
            for tail in common
            if all(length in run[tail].shape for run, length in zip(runs, lengths, strict=True))
            and len({math.prod(run[tail].shape) / length for run, length in zip(runs, lengths, strict=True)}) == 1
        ]
        is_wide = any(len(runs[0][tail].shape) == 2 and min(runs[0][tail].shape) > 1 for tail in chained)
        if len(chained) > 1 and is_wide and (len(set(lengths)) > 1 or RUN_WORDS.search(head)):
            others = dict.fromkeys(tail.lstrip("./_") for run in runs for tail in run if tail not in chained)
            return [{tail: run[tail] for tail in run if tail in chained} for run in runs], list(others)
    return [], []


def _describe_left_out(signals: Sequence[str], why: str) -> str:
    """Return which signals are left out, such as those that not all runs have."""
    if not signals:
        return ""
    shown = ", ".join(name[:_SHOWN] for name in signals[:_SHOWN_SIGNALS])
    more = f" and {len(signals) - _SHOWN_SIGNALS} more" if len(signals) > _SHOWN_SIGNALS else ""
    return f"; left out is what {why}: {shown}{more}"


_SHOWN, _SHOWN_SIGNALS = 60, 8
"""Characters of a name, and signals, that a remark shows."""


def _chain_runs(runs: Sequence[dict[str, StoredArray]]) -> list[StoredArray]:
    """Return the signals of all runs one behind another, and the number of the run of every row."""
    lengths = [_find_length(list(run.values())) for run in runs]
    ends = np.cumsum(lengths)

    def make_reader(parts: Sequence[StoredArray]) -> Callable[[int, int, int], FloatArray]:
        def read(first: int, last: int, axis: int) -> FloatArray:
            del axis  # rows run along the first axis here, however they lie in the file
            rows = []
            for part, length, end in zip(parts, lengths, ends, strict=True):
                begin = int(end) - length
                if first < end and last > begin:
                    own_first, own_last = max(first - begin, 0), min(last - begin, length)
                    values = part.read(own_first, own_last, part.shape.index(length))
                    rows.append(np.asarray(values, dtype=np.float64).reshape(own_last - own_first, -1))
            return np.concatenate(rows)

        return read

    def number_runs(first: int, last: int, axis: int) -> FloatArray:
        del axis
        return np.searchsorted(ends, np.arange(first, last), side="right").astype(np.float64)

    total = int(ends[-1])
    signals = [
        StoredArray(tail.lstrip("./_"), (total, math.prod(runs[0][tail].shape) // lengths[0]), make_reader(parts))
        for tail in runs[0]
        for parts in [[run[tail] for run in runs]]
    ]
    return [*signals, StoredArray("segment", (total,), number_runs)]


def _distinguish(names: Sequence[str]) -> list[str]:
    """Return names that differ: one that was there before has a number of its own behind it."""
    taken, own = set(names), list[str]()
    seen: Counter[str] = Counter()
    for name in names:
        seen[name] += 1
        other = name
        while seen[name] > 1 and (other := f"{name}_{seen[name]}") in taken:
            seen[name] += 1
        taken.add(other)
        own.append(other)
    return own


_LOOKED_AT = 4096


def _split_timed_pairs(arrays: Sequence[StoredArray]) -> list[StoredArray]:
    """Return pairs of time and value, an array for each signal, as two arrays; others as they are.

    Loggers that store one signal an array do so for all: each of at least two arrays of two columns has rising times.
    """
    pairs = [array for array in arrays if len(array.shape) == 2 and 2 in array.shape and max(array.shape) > FEWEST_ROWS]
    if len(pairs) < 2 or any(is_time_name(array.name) for array in arrays):
        return list(arrays)
    begins = []
    for array in pairs:
        length = max(array.shape)
        times = array.read(0, min(length, _LOOKED_AT), array.shape.index(length))[:, 0]
        if not (np.diff(times) > 0.0).all():
            return list(arrays)
        begins.append((float(times[0]), float(times[-1])))
    if max(begin for begin, _ in begins) >= min(end for _, end in begins):
        return list(arrays)

    def split(array: StoredArray) -> Iterator[StoredArray]:
        for column, ending in enumerate(("time", "data")):
            yield StoredArray(f"{array.name}/{ending}", (max(array.shape),), partial(_read_column, array, column))

    return [part for array in arrays for part in (split(array) if array in pairs else (array,))]


def _read_column(array: StoredArray, column: int, first: int, last: int, axis: int) -> FloatArray:
    """Read a part of one of an array's two columns; the axis is that of the column alone."""
    del axis
    return array.read(first, last, array.shape.index(max(array.shape)))[:, column]


def _name_by_labels(arrays: Sequence[StoredArray]) -> list[StoredArray]:
    """Return the arrays by their labels; of several that are called alike, each keeps the name of its place."""
    called = Counter(name for array in arrays for name in {array.name, array.label or array.name})
    return [replace(array, name=array.label) if called[array.label] == 1 else array for array in arrays]


_SAME, _SHARED = 0.01, 0.5
"""Steps by which two clocks differ that are taken for one; and the least share of the longer one that two clocks of
equal length have in common: otherwise they count in different units or from different moments."""


def _join_clocks(arrays: Sequence[StoredArray]) -> tuple[list[StoredArray], tuple[str, ...]]:
    """Return arrays of groups with different clocks at the times of the longest, and a remark.

    Nothing is joined where there is one clock, or the arrays without a time are most of the file.
    """
    arrays = [array for array in arrays if max(array.shape) >= FEWEST_ROWS]
    clocks = {
        re.split(r"[./][^./]*$", array.name)[0]: array
        for array in reversed(arrays)
        if math.prod(array.shape) == max(array.shape) and is_time_name(array.name) and re.search(r"[./]", array.name)
    }
    groups: dict[str, list[StoredArray]] = {}
    outside: list[StoredArray] = []
    for array in arrays:
        # A time is that of all that stands in its group, and deeper.
        around = [group for group in clocks if array.name.startswith((f"{group}.", f"{group}/"))]
        (groups.setdefault(max(around, key=len), []) if around else outside).append(array)
    timed = {group: max(clock.shape) for group, clock in clocks.items()}
    if len(timed) < 2 or (outside and _find_length(arrays) not in timed.values()):
        return [], ()
    main = max(reversed(timed), key=lambda group: timed[group])
    main_clock = clocks[main]
    joined = [array for array in (*groups[main], *outside) if timed[main] in array.shape]
    # What is read at other times is held in memory, and all clocks are.
    n_held = timed[main] + sum(math.prod(own.shape) for group in groups if group != main for own in groups[group])
    if 8 * n_held > MOST_UNPACKED:
        return [], ()
    t = _read_clock(main_clock)
    is_one = True
    foreign = []
    for group, clock in clocks.items():
        own = _read_clock(clock) if group != main else t
        is_as_long = len(own) == len(t)
        shared = min(own[-1], t[-1]) - max(own[0], t[0])
        least = _SHARED * max(np.ptp(own), np.ptp(t)) if is_as_long else 0.0
        if not (np.diff(own) > 0.0).all():
            return [], ()
        if is_as_long and not shared >= least:
            apart = (
                f"The times of {main} and {group} have less than half of their span in common, and equally many rows: "
                "they are read side by side, row by row. Is that wrong, give them as files of their own.",
            )
            return [], apart
        if not shared >= 0.0:
            foreign.append(describe_foreign_clock(group, (own[0], own[-1]), main, (t[0], t[-1])))
            # It stays among the others' names, and has not as many rows as they.
            joined += groups[group]
            is_one = False
            continue
        is_one &= is_as_long and bool(np.abs(own - t).max() <= _SAME * np.median(np.diff(t)))
        members = [array for array in groups[group] if array is not clock and timed[group] in array.shape]
        joined += [_resample(array, own, t) for array in members if group != main]
    left_out = [array.label or array.name for array in outside if timed[main] not in array.shape]
    remark = (
        "Groups of arrays have times of their own: they are read at those of the longest, on a straight line between "
        f"two samples{_describe_left_out(left_out, 'has no time')}."
    )
    return ([], ()) if is_one else (joined, (*foreign, *[remark][: len(timed) - 1 - len(foreign)]))


def _read_clock(clock: StoredArray) -> FloatArray:
    length = max(clock.shape)
    return _read_rows(_ArrayColumn(clock, clock.shape.index(length), 0), 0, length)[:, 0]


def _resample(array: StoredArray, own: FloatArray, t: FloatArray) -> StoredArray:
    """Return an array with the times `own` (k,) at times t (m,); outside of them it has no numbers."""

    @cache
    def load() -> FloatArray:
        return np.asarray(array.read(0, len(own), array.shape.index(len(own))), dtype=np.float64).reshape(len(own), -1)

    def read(first: int, last: int, axis: int) -> FloatArray:
        del axis
        part = t[first:last]
        return np.column_stack([np.interp(part, own, column, left=np.nan, right=np.nan) for column in load().T])

    return StoredArray(array.name, (len(t), math.prod(array.shape) // len(own)), read, array.label)


def _describe_no_arrays(deep: StoredArray | None, unread: Mapping[str, str]) -> str:
    """Return why a file without usable arrays cannot be read; `deep` is an array of more than two axes."""
    if unread:
        return next(iter(unread.values()))
    if deep is None:
        return "The file contains no arrays of numbers with rows."
    return (
        f"The array {deep.name} has {len(deep.shape)} axes ({' x '.join(map(str, deep.shape))}): save an array of rows "
        "x joints for each signal, np.savez('run.npz', t=t, q=q, tau=tau)."
    )


def _read_rows(place: _ArrayColumn, first: int, last: int) -> FloatArray:
    """Read the rows of an array, and say which array it is if that fails."""
    try:
        return place.stored.read(first, last, place.axis).reshape(last - first, -1)
    except (OSError, RuntimeError, TypeError, ValueError, ArithmeticError) as error:
        raise RecordingError(
            f"{place.stored.name} cannot be read from row {first + 1} on: {error}",
            pointer=place.stored.name,
            title=TITLE,
        ) from error


def _find_stated_rate(arrays: Sequence[StoredArray]) -> float | None:
    """Return the Hz that a single number of the file says, such as Ts = 0.005; None where none or several do."""
    rates = set()
    for array in arrays:
        name = re.split(r"[./]", array.name)[-1]
        if math.prod(array.shape) != 1 or not (_PERIOD.fullmatch(name) or _RATE.fullmatch(name)):
            continue
        value = float(_read_rows(_ArrayColumn(array, 0, 0), 0, 1)[0, 0])
        rate = value if _RATE.fullmatch(name) else 1.0 / value if value > 0.0 else 0.0
        if _SLOWEST <= rate <= _FASTEST:
            rates.add(rate)
    return rates.pop() if len(rates) == 1 else None


def _find_length(arrays: Sequence[StoredArray]) -> int:
    """Return the number of rows: the length that most columns share, and of these the largest.

    It is the longer side of one array at the least: a recording has more rows than signals.
    """
    longer = {max(array.shape) for array in arrays}
    shared: Counter[int] = Counter()
    for array in arrays:
        for axis, size in enumerate(array.shape):
            if size >= FEWEST_ROWS and size in longer:
                # A square or wide array of settings may have many columns: it counts as no more than 64.
                shared[size] += min(64, array.shape[1 - axis]) if len(array.shape) == 2 else 1
    return max(shared, key=lambda size: (shared[size], size))


def _find_prefix(names: Sequence[str]) -> str:
    """Return the group that all arrays are in, which says nothing."""
    shortest = min(names, key=len) if len(names) > 1 else ""
    for cut in range(len(shortest), 0, -1):
        if shortest[cut - 1] in "./" and all(name.startswith(shortest[:cut]) for name in names):
            return shortest[:cut]
    return ""
