"""Reader of KUKA RSI logs: XML telegrams `<Rob …>`, a row each.

Attributes are columns (`AIPos.A1`), and so are elements that hold a number (`IPOC`). Whatever stands between the
telegrams, stamps of a logger or the answers `<Sen …>`, is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa

from dynident.recordings.arrow_tables import from_numbers
from dynident.recordings.file_size_limits import TITLE, check_columns, choose_block_rows
from dynident.recordings.file_source import FileSource
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
