"""Bags of ROS 2 that are a data base of SQLite: two tables are read, and nothing that the file defines is run.

A file of SQLite can hold views, triggers and computed columns, which are programs; some never end. A bag has none.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from dynident.arrays import IntArray
from dynident.recordings.file_limits import LARGEST_CHUNK, TITLE, check_columns
from dynident.recordings.formats.packed_messages import KNOWN, PackedMessage, check_message
from dynident.recordings.types import RecordingError

_ROWS_AT_ONCE = 500
_LONGEST_WAIT = 20.0
"""Seconds for one row. A row is found in microseconds, on a slow disk in milliseconds."""
_STEPS = 100_000
"""Steps of SQLite's machine between two looks at the clock, about a millisecond."""
_NEEDED = {"topics": ("id", "name", "type"), "messages": ("topic_id", "timestamp", "data")}


def ros2_messages(path: Path) -> Iterator[PackedMessage]:
    """Give the messages that hold signals of joints, by their time.

    Raises
    ------
    RecordingError
        The file holds anything but tables and indices, or is damaged.
    """
    with closing(_Bag(path)) as bag:
        topics = bag.topics()
        texts = bag.definitions()
        for key, stamp, data in bag.messages(list(topics)):
            name, kind = topics[key]
            if not isinstance(data, bytes):
                raise ValueError(f"a message of {name} is not stored as bytes")
            check_message(name, len(data))
            yield PackedMessage(name, kind, texts.get(kind, ""), stamp, data)


class _Bag:
    """The data base of a bag, opened for reading alone."""

    def __init__(self, path: Path) -> None:
        self._size = path.stat().st_size
        # Nothing else writes to the file: no lock is taken, and no file beside it is looked at.
        self._base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        self._deadline = np.inf
        self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_CHUNK)
        self._base.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        self._base.set_progress_handler(lambda: time.monotonic() > self._deadline, _STEPS)
        try:
            for setting in ("trusted_schema=OFF", "query_only=ON", "cell_size_check=ON", "temp_store=MEMORY"):
                self._rows(f"PRAGMA {setting}")
            self._tables = self._checked_tables()
        except BaseException:
            self._base.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._base.close()

    def _rows(self, query: str, values: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
        return list(self._stream(query, values))

    def _stream(self, query: str, values: tuple[object, ...] = ()) -> Iterator[tuple[object, ...]]:
        """The rows of a query, as long as one after another comes."""
        self._deadline = time.monotonic() + _LONGEST_WAIT
        cursor = self._base.execute(query, values)
        while rows := cursor.fetchmany(_ROWS_AT_ONCE):
            self._deadline = np.inf
            yield from rows
            self._deadline = time.monotonic() + _LONGEST_WAIT

    def _checked_tables(self) -> set[str]:
        tables = set()
        for kind, name, root, text in self._stream("SELECT type, name, rootpage, sql FROM sqlite_master"):
            virtual = kind == "table" and (not root or "virtual" in str(text).casefold().split()[1:2])
            if kind not in ("table", "index") or virtual:
                raise RecordingError(
                    f"The bag holds {name}, a {'virtual table' if virtual else kind}; a bag of ROS 2 has tables and "
                    "indices alone. Convert it where it was recorded (ros2 bag convert).",
                    pointer=str(name),
                    title=TITLE,
                )
            if kind == "table":
                tables.add(str(name))
        for table, columns in _NEEDED.items():
            if table not in tables:
                raise RecordingError(f"The bag has no table {table}: it is no bag of ROS 2.", title=TITLE)
            # The last value says whether a column is computed from others.
            stored = {row[1]: row[6] for row in self._rows(f"PRAGMA table_xinfo({table})")}
            for column in columns:
                if stored.get(column, 1):
                    detail = f"The table {table} of the bag has no stored column {column}: it is no bag of ROS 2."
                    raise RecordingError(detail, title=TITLE)
        return tables

    def topics(self) -> dict[object, tuple[str, str]]:
        """Name and type of the topics that hold signals of joints, by their keys."""
        rows = self._rows("SELECT id, name, type FROM topics")
        check_columns(len(rows))
        return {key: (str(name), str(kind)) for key, name, kind in rows if kind in KNOWN and isinstance(key, int)}

    def definitions(self) -> dict[str, str]:
        """The texts that define types, where the bag has them."""
        if "message_definitions" not in self._tables:
            return {}
        rows = self._rows("SELECT topic_type, encoded_message_definition FROM message_definitions")
        return {kind: text for kind, text in rows if isinstance(kind, str) and isinstance(text, str)}

    def messages(self, topics: list[object]) -> Iterator[tuple[object, int, object]]:
        """Topic, time and data of the messages of some topics, by their time."""
        rows = self._rows_by_time(topics)
        for first in range(0, len(rows), _ROWS_AT_ONCE):
            keys = rows[first : first + _ROWS_AT_ONCE].tolist()
            marks = ",".join("?" * len(keys))
            query = f"SELECT rowid, topic_id, timestamp, data FROM messages WHERE rowid IN ({marks})"
            block = {row[0]: row[1:] for row in self._rows(query, tuple(keys))}
            for key in keys:
                topic, stamp, data = block[key]
                assert isinstance(stamp, int)
                yield topic, stamp, data

    def _rows_by_time(self, topics: list[object]) -> IntArray:
        """The numbers of the rows of some topics, by their time: sorted here, where it takes 16 bytes a row.

        Raises
        ------
        ValueError
            The rows do not count upward, or hold more bytes than the file: pages of a damaged file lead round in a
            circle.
        """
        wanted = set(topics)
        rows: list[IntArray] = []
        last, held = -(2**63), 0
        block: list[tuple[int, int]] = []
        query = "SELECT rowid, topic_id, timestamp, length(data) FROM messages NOT INDEXED ORDER BY rowid"
        for row, topic, stamp, size in self._stream(query):
            assert isinstance(row, int)
            held += size if isinstance(size, int) else 0
            if row <= last or held > self._size:
                raise ValueError("the data base is damaged: pages of its table of messages stand in it twice")
            last = row
            if topic in wanted:
                if not isinstance(stamp, int):
                    raise ValueError(f"the time of message {row} is {stamp!r}")
                block.append((stamp, row))
            if len(block) == _ROWS_AT_ONCE:
                rows.append(np.array(block, dtype=np.int64))
                block = []
        rows.append(np.array(block, dtype=np.int64).reshape(-1, 2))
        whole = np.concatenate(rows)
        return np.asarray(whole[np.argsort(whole[:, 0], kind="stable"), 1])
