"""Readers of KUKA's files: telegrams of RSI (XML), and traces of the controller, which are data sets of DIAdem.

Each telegram `<Rob …>` is a row. Attributes are columns (`AIPos.A1`), and so are elements that hold a number (`IPOC`).
Whatever stands between the telegrams, stamps of a logger or the answers `<Sen …>`, is passed over.

A data set of DIAdem, of KUKA or of others, is a header of text (.dat) that names the channels, and one or more files
with their numbers (.r64). The keys of the header are numbers ("Header file", NI DIAdem help).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import from_numbers
from dynident.recordings.file_size_limits import TITLE, check_columns, choose_block_rows
from dynident.recordings.file_source import FileSource
from dynident.recordings.formats.array_files import ArrayFileSource, StoredArray
from dynident.recordings.recording_metadata import RecordingError

_BEGIN = b"<Rob"
START = re.compile(rb"<Rob[\s>]")
_END = b"</Rob>"
_READ_BYTES = 1 << 20
_LONGEST_BYTES = 1 << 16
"""The robot sends a telegram as one packet, which is no longer."""
_LOOKED_AT = 64
_BLOCK_ROWS = 8192
_UNITS = {"AIPos.A": "deg", "ASPos.A": "deg", "IPOC": "ms"}
"""What the interface fixes; currents are in A or in per cent, as the context on the controller has it."""


class TelegramSource(FileSource):
    """The numbers in telegrams, one row each."""

    sample_rows = 16_000
    """They are taken apart one by one: of more rows a look would take seconds."""

    def __init__(self, path: Path) -> None:
        self._path = path
        names: dict[str, None] = {}
        for number, telegram in enumerate(_read_telegrams(path)):
            names.update(dict.fromkeys(_parse_numbers(telegram, number)))
            check_columns(len(names))
            if number + 1 == _LOOKED_AT:
                break
        if not names:
            raise RecordingError("The file contains no complete telegram <Rob …>…</Rob>.", title=TITLE)
        super().__init__(list(names), {name: unit for name in names if (unit := _UNITS.get(name.rstrip("0123456789")))})

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        rows: list[list[float]] = []
        most = min(_BLOCK_ROWS, choose_block_rows(len(columns)))
        for number, telegram in enumerate(_read_telegrams(self._path)):
            values = _parse_numbers(telegram, number)
            rows.append([values.get(name, np.nan) for name in columns])
            if len(rows) == most:
                yield _make_batch(rows, columns)
                rows = []
        if rows:
            yield _make_batch(rows, columns)


def _make_batch(rows: list[list[float]], columns: list[str]) -> pa.RecordBatch:
    table = np.array(rows, dtype=np.float64)
    return pa.RecordBatch.from_arrays([from_numbers(table[:, k].copy()) for k in range(len(columns))], names=columns)


def _read_telegrams(path: Path) -> Iterator[bytes]:
    """Yield the telegrams of a file of any size one by one; one that the end cuts off is left out."""
    waiting = b""
    with path.open("rb") as file:
        while part := file.read(_READ_BYTES):
            # The last piece is no telegram yet: it waits for the next bytes.
            *whole, waiting = (waiting + part).split(_END)
            for text in whole:
                # What was broken off before the next one began is left out.
                begins = text.rfind(_BEGIN)
                if START.match(text, max(begins, 0)):
                    yield text[begins:] + _END
            # A file without any end of a telegram must not fill the memory.
            waiting = waiting[-_LONGEST_BYTES:]


def _parse_numbers(telegram: bytes, number: int) -> dict[str, float]:
    try:
        root = ElementTree.fromstring(telegram)
    except ElementTree.ParseError as error:
        raise RecordingError(
            f"Telegram {number + 1} is not valid XML: {error}.", title=TITLE, row=number + 1
        ) from error
    values: dict[str, float] = {}
    for element in root.iter():
        texts = {f"{element.tag}.{key}": text for key, text in element.attrib.items()}
        texts[element.tag] = element.text or ""
        for name, text in texts.items():
            try:
                values.setdefault(name, float(text))
            except ValueError:
                continue
    return values


def open_telegrams(path: Path) -> TelegramSource:
    """Open a log of telegrams.

    Raises
    ------
    RecordingError
        For a file without a whole one, or with one that is no XML.
    """
    return TelegramSource(path)


_CHANNEL, _END_OF_CHANNEL = "#BEGINCHANNELHEADER", "#ENDCHANNELHEADER"
_KEY = re.compile(r"^\s*(\d+)\s*,(.*?)\s*$", re.MULTILINE)
_NAME, _UNIT, _KIND, _FILE, _ORDER, _TYPE, _COUNT, _FIRST = "200", "202", "210", "211", "213", "214", "220", "221"
_OFFSET, _FACTOR = "240", "241"
"""Keys of a channel: how its numbers are stored, how many there are and where the first is, and what makes them values:
offset + factor times the number, or times the number of the row where nothing is stored."""
_TYPES = {
    "REAL32": "f4", "REAL64": "f8", "INT16": "i2", "INT32": "i4", "WORD8": "u1", "WORD16": "u2", "WORD32": "u4"
}  # fmt: skip
_LARGEST_HEADER, _SHOWN = 1 << 24, 100
_SANE = (1e-30, 1e30)
"""Sizes of numbers that are measured; read with the bytes in the wrong order they have any."""


def open_data_set(path: Path) -> ArrayFileSource:
    """Open a data set of DIAdem by its header.

    Parameters
    ----------
    path : path
        Of the header (.dat); the files with the numbers lie beside it.

    Returns
    -------
    ArrayFileSource
        A column for each channel of the usual length.

    Raises
    ------
    RecordingError
        For a header that is damaged, or numbers that are missing or stored in another way.
    """
    if path.stat().st_size > _LARGEST_HEADER:
        raise RecordingError(f"The header of the data set is longer than {_LARGEST_HEADER >> 20} MB.", title=TITLE)
    # Channels of controllers are named in the code page of Windows.
    text = path.read_text(encoding="cp1252", errors="replace")
    check_columns(text.count(_CHANNEL))
    headers = [
        {key: value.strip() for key, value in _KEY.findall(channel)}
        for channel, closed, _ in (part.partition(_END_OF_CHANNEL) for part in text.split(_CHANNEL)[1:])
        if closed
    ]
    of_file: dict[str, int] = {}
    for header in headers:
        of_file[header.get(_FILE, "")] = of_file.get(header.get(_FILE, ""), 0) + 1
    channels = []
    units = {}
    for number, header in enumerate(headers):
        name = header.get(_NAME) or f"channel{number + 1}"
        try:
            count = int(header[_COUNT])
            offset, factor = (float(header.get(key) or usual) for key, usual in ((_OFFSET, 0.0), (_FACTOR, 1.0)))
            stored = None if header.get(_KIND, "").startswith("IMPL") else _map_numbers(path, header, of_file, count)
        except (KeyError, ValueError) as error:
            raise RecordingError(f"The header of the channel {name} is damaged: {error}", title=TITLE) from error
        channels.append((name, count, stored, offset, factor))
        units[name] = header.get(_UNIT, "")
    # A channel that is counted has no numbers in a file, and may state any length.
    longest = max((count for _, count, stored, _, _ in channels if stored is not None), default=0)
    source = ArrayFileSource(
        [
            StoredArray(name, (min(count, longest),), _make_channel_reader(stored, offset, factor))
            for name, count, stored, offset, factor in channels
        ]
    )
    source.units = {name: unit for name, unit in units.items() if unit and name in source.names}
    return source


def _make_channel_reader(
    stored: np.ndarray[tuple[int], np.dtype[np.generic]] | None, offset: float, factor: float
) -> Callable[[int, int, int], FloatArray]:
    def read(first: int, last: int, axis: int) -> FloatArray:
        del axis
        numbers = np.arange(first, last) if stored is None else stored[first:last]
        return offset + factor * np.asarray(numbers, dtype=np.float64)

    return read


def _map_numbers(
    path: Path, header: Mapping[str, str], of_file: Mapping[str, int], count: int
) -> np.ndarray[tuple[int], np.dtype[np.generic]]:
    """Return the numbers of a channel, which stay on the disk."""
    name = header[_FILE].replace("\\", "/").rpartition("/")[2]
    file = path.parent / name
    # A header may name any file: it is followed to one of its own name, beside it. In a store others' files lie there.
    if Path(name).stem.lower() != path.stem.lower() or not _is_beside(file, path):
        raise RecordingError(
            f"The file is the header of a data set whose numbers are in {name[:_SHOWN]}: put that beside it, in the "
            "same folder, and leave both their common name; or write both as CSV.",
            title=TITLE,
        )
    if header.get(_TYPE) not in _TYPES:
        raise RecordingError(
            f"The numbers in {name} are stored as {header.get(_TYPE)}; known are {', '.join(_TYPES)}. Write the data "
            "set as CSV.",
            title=TITLE,
        )
    kind = np.dtype("<" + _TYPES[header[_TYPE]])
    first = int(header.get(_FIRST) or 1) - 1
    # In blocks the channels of a file take turns, row by row; else one stands behind the other.
    step = of_file[header[_FILE]] if header.get(_ORDER, "BLOCK").startswith("BLOCK") else 1
    if first < 0 or count < 1 or (first + (count - 1) * step + 1) * kind.itemsize > file.stat().st_size:
        raise RecordingError(
            f"{name} has fewer numbers than the header says: copy both files again from the controller.", title=TITLE
        )
    numbers = np.memmap(file, dtype=kind, mode="r")[first : first + count * step : step][:count]
    # The key of the header for the order of the bytes is not to be relied on: numbers themselves tell it.
    return numbers if _are_sane(numbers) else numbers.view(numbers.dtype.newbyteorder())


def _is_beside(file: Path, header: Path) -> bool:
    """Return whether a file is there, in the folder of the header and not elsewhere through a link."""
    try:
        return file.is_file() and file.resolve().parent == header.resolve().parent
    except (OSError, ValueError):  # a name that no file can have
        return False


def _are_sane(numbers: np.ndarray[tuple[int], np.dtype[np.generic]]) -> bool:
    if numbers.dtype.kind != "f":
        return True
    sizes = np.abs(np.asarray(numbers[:1000], dtype=np.float64))
    return bool(((sizes == 0.0) | ((sizes > _SANE[0]) & (sizes < _SANE[1]))).all())
