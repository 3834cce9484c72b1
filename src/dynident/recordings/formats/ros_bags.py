"""Containers of ROS 1 (.bag) and ROS 2 bags (SQLite, MCAP): their messages, read safely and with limits.

A file of SQLite can hold views, triggers and computed columns, which are programs; some never end. A bag has none.
"""

from __future__ import annotations

import bz2
import heapq
import math
import sqlite3
import time
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import chain, count, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from dynident.array_types import IntArray
from dynident.recordings.file_size_limits import (
    LARGEST_CHUNK,
    TITLE,
    BoundedFile,
    UnpackedSize,
    check_chunk,
    check_columns,
)
from dynident.recordings.formats.packed_messages import KNOWN, PackedMessage, normalise_type
from dynident.recordings.recording_metadata import RecordingError


def read_ros1_messages(path: Path) -> Iterator[PackedMessage]:
    """Yield the messages that hold signals of joints, by their time."""
    with _open_reader(path) as reader:
        connections = [candidate for candidate in reader.connections if normalise_type(candidate.msgtype) in KNOWN]
        if not connections and reader.connections:
            raise _refuse_topics((other.topic, other.msgtype) for other in reader.connections)
        for connection, stamp, data in reader.messages(connections=connections):
            text = connection.msgdef.data
            yield PackedMessage(connection.topic, normalise_type(connection.msgtype), text, stamp, bytes(data))


def _refuse_topics(topics: Iterable[tuple[str, str]]) -> RecordingError:
    """Return the error of a bag that has topics (name, type), but none with signals of joints."""
    names = [f"{name} ({kind})" for name, kind in topics]
    shown = ", ".join(names[:_SHOWN]) + (", …" if len(names) > _SHOWN else "")
    return RecordingError(
        f"The bag contains no joint states, but {shown}. If one of them holds positions and torques, write it as CSV "
        "(rostopic echo -b run.bag -p TOPIC > run.csv; ros2 topic echo --csv TOPIC > run.csv while the bag plays); or "
        "record messages of the type sensor_msgs/JointState, with position and effort.",
        title=TITLE,
    )


_SHOWN = 6
"""Topics that a message lists."""


class _BoundedPath:
    """Stands in for a path: the package opens it and gets a file that is never asked for more than it holds."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def exists(self) -> bool:
        """Whether there is such a file."""
        return self._path.exists()

    def open(self, mode: str) -> BoundedFile:
        """Open it for reading bytes, whatever the mode."""
        return BoundedFile(self._path.open("rb"))


def _open_reader(path: Path) -> Any:
    """Return the package's reader, changed so that chunks stand in the file once each and unpack within limits."""
    from lz4.frame import decompress as decompress_lz4
    from rosbags.rosbag1 import Reader

    unpacked = UnpackedSize(path.stat().st_size)
    # By the functions that the package takes.
    bounded = {bz2.decompress: _unpack_bz2, decompress_lz4: _unpack_lz4}

    class BoundedReader(Reader):
        def read_chunk_info(self) -> Any:
            info = super().read_chunk_info()
            # An index that names one large chunk many times would unpack it many times.
            if any(info.pos == other for other in positions):
                raise ValueError(f"two chunks begin at byte {info.pos}")
            positions.add(info.pos)
            return info

        def read_chunk(self) -> Any:
            chunk = super().read_chunk()
            unpack = bounded.get(chunk.decompressor)
            if unpack is None:  # it is not compressed
                check_chunk(chunk.datasize, "A chunk of the bag")
                return chunk

            def decompress(data: bytes) -> bytes:
                content: bytes = unpack(data)
                check_chunk(len(content), "A chunk of the bag")
                unpacked.add(len(content))
                return content

            return chunk._replace(decompressor=decompress)

    positions: set[int] = set()
    file: Any = _BoundedPath(path)
    return BoundedReader(file)


def _unpack_bz2(data: bytes) -> bytes:
    return bz2.BZ2Decompressor().decompress(data, LARGEST_CHUNK + 1)


def _unpack_lz4(data: bytes) -> bytes:
    from lz4.frame import LZ4FrameDecompressor

    content: bytes = LZ4FrameDecompressor().decompress(data, LARGEST_CHUNK + 1)
    return content


_ROWS_AT_ONCE = 1000
_LONGEST_WAIT = 20.0
"""Seconds for one row. A row is found in microseconds, on a slow disk in milliseconds."""
_STEPS = 100_000
"""Steps of SQLite's machine between two looks at the clock, about a millisecond."""
_NEEDED = {"topics": ("id", "name", "type"), "messages": ("topic_id", "timestamp", "data")}


def read_ros2_messages(path: Path) -> Iterator[PackedMessage]:
    """Yield the messages that hold signals of joints, by their time.

    Raises
    ------
    RecordingError
        The file holds anything but tables and indices, or is damaged.
    """
    with closing(_Bag(path)) as bag:
        texts = bag.read_definitions()
        topics = {key: (name, kind, texts.get(kind, "")) for key, (name, kind) in bag.read_topics().items()}
        for key, stamp, data in bag.read_messages(list(topics)):
            if not isinstance(data, bytes):
                raise ValueError(f"a message of {topics[key][0]} is not stored as bytes")
            yield PackedMessage(*topics[key], stamp, data)


class _Bag:
    """The data base of a bag, opened read-only."""

    def __init__(self, path: Path) -> None:
        self._size = path.stat().st_size
        # Nothing else writes to the file: no lock is taken, and no file beside it is looked at.
        self._base = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        self._deadline = math.inf
        # No value may be longer than what is unpacked at once, and no other data base may be attached.
        self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_CHUNK)
        self._base.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        # A query on a damaged file may never end. SQLite calls this between its steps, and stops where it returns true.
        self._base.set_progress_handler(lambda: time.monotonic() > self._deadline, _STEPS)
        try:
            for setting in ("trusted_schema=OFF", "query_only=ON", "cell_size_check=ON", "temp_store=MEMORY"):
                self._fetch_rows(f"PRAGMA {setting}")
            self._tables = self._check_tables()
        except BaseException:
            self._base.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._base.close()

    def _fetch_rows(self, query: str, values: tuple[object, ...] = ()) -> list[tuple[Any, ...]]:
        return list(chain.from_iterable(self._fetch_blocks(query, values)))

    def _fetch_blocks(self, query: str, values: tuple[object, ...] = ()) -> Iterator[list[tuple[Any, ...]]]:
        """Yield the rows of a query in blocks; a single wait of `_LONGEST_WAIT` ends it."""
        self._deadline = time.monotonic() + _LONGEST_WAIT
        cursor = self._base.execute(query, values)
        while rows := cursor.fetchmany(_ROWS_AT_ONCE):
            # The clock stands still while the caller works on the rows.
            self._deadline = math.inf
            yield rows
            self._deadline = time.monotonic() + _LONGEST_WAIT

    def _check_tables(self) -> set[str]:
        tables = set()
        for kind, name, root, text in self._fetch_rows("SELECT type, name, rootpage, sql FROM sqlite_master"):
            virtual = kind == "table" and (not root or "virtual" in str(text).casefold().split()[1:2])
            if kind not in ("table", "index") or virtual:
                raise RecordingError(
                    f"The bag contains {name}, a {'virtual table' if virtual else kind}; a ROS 2 bag contains only "
                    "tables and indices. Convert it on the computer that recorded it (ros2 bag convert).",
                    pointer=str(name),
                    title=TITLE,
                )
            if kind == "table":
                tables.add(str(name))
        for table, columns in _NEEDED.items():
            if table not in tables:
                raise RecordingError(
                    f"The database has no table {table}, so it is not a ROS 2 bag. Export the table that you need as "
                    "CSV.",
                    title=TITLE,
                )
            # The last value says whether a column is computed from others.
            stored = {row[1]: row[6] for row in self._fetch_rows(f"PRAGMA table_xinfo({table})")}
            for column in columns:
                if stored.get(column, 1):
                    detail = f"The table {table} of the bag has no stored column {column}, so it is not a ROS 2 bag."
                    raise RecordingError(detail, title=TITLE)
        return tables

    def read_topics(self) -> dict[object, tuple[str, str]]:
        """Return name and type of the topics that hold signals of joints, by their keys."""
        rows = self._fetch_rows("SELECT id, name, type FROM topics")
        check_columns(len(rows))
        known: dict[object, tuple[str, str]] = {
            key: (str(name), str(kind)) for key, name, kind in rows if kind in KNOWN and isinstance(key, int)
        }
        if rows and not known:
            raise _refuse_topics((str(name), str(kind)) for _, name, kind in rows)
        return known

    def read_definitions(self) -> dict[str, str]:
        """Return the texts that define types, if the bag has them."""
        if "message_definitions" not in self._tables:
            return {}
        rows = self._fetch_rows("SELECT topic_type, encoded_message_definition FROM message_definitions")
        return {kind: text for kind, text in rows if isinstance(kind, str) and isinstance(text, str)}

    def read_messages(self, topics: list[object]) -> Iterator[tuple[Any, ...]]:
        """Yield topic, time and data of the messages of some topics, by their time."""
        every = self._sort_rows_by_time(topics)
        for first in range(0, len(every), _ROWS_AT_ONCE):
            keys = every[first : first + _ROWS_AT_ONCE]
            # By row numbers, which are found at once: sorting whole messages by time would need room for all of them
            # on disk.
            query = f"SELECT topic_id, timestamp, data FROM messages WHERE rowid IN ({','.join('?' * len(keys))})"
            rows = self._fetch_rows(query, tuple(np.sort(keys).tolist()))
            # They come by their numbers.
            yield from (rows[place] for place in np.argsort(np.argsort(keys)).tolist())

    def _sort_rows_by_time(self, topics: list[object]) -> IntArray:
        """Return the row numbers of the messages of some topics, by their time: sorted here, in 16 bytes a row.

        Raises
        ------
        ValueError
            The rows do not count upward, or hold more bytes than the file: pages of a damaged file lead round in a
            circle.
        """
        last, held = -(2**63), 0
        parts: list[IntArray] = [np.empty((0, 2), dtype=np.int64)]
        query = "SELECT rowid, topic_id, timestamp, length(data) FROM messages NOT INDEXED ORDER BY rowid"
        for rows in self._fetch_blocks(query):
            try:
                block = np.array(rows, dtype=np.int64)
            except (TypeError, ValueError, OverflowError):
                raise ValueError(f"topic, time or data of a message are empty (first at row {rows[0][0]})") from None
            held += int(block[:, 3].sum())
            if block[0, 0] <= last or (np.diff(block[:, 0]) <= 0).any() or held > self._size:
                raise ValueError("the database is damaged: pages of its message table occur twice")
            last = int(block[-1, 0])
            parts.append(block[np.isin(block[:, 1], np.array(topics))][:, [2, 0]])
        whole = np.concatenate(parts)
        return np.asarray(whole[np.argsort(whole[:, 0], kind="stable"), 1])


_FOOTER = 9 + 8 + 8 + 4
_MAGIC = 8
_END = b"\x89MCAP0\r\n"
_RECORD_HEAD = 9
"""The code and the length of a record."""
_AHEAD = 10_000
"""Messages within which those of a file without an index are put in order."""


def read_mcap_messages(path: Path) -> Iterator[PackedMessage]:
    """Yield the messages that hold signals of joints, by their time."""
    with path.open("rb") as opened:
        file = _McapFile(BoundedFile(opened))
        for schema, channel, message in file.read_messages():
            text = schema.data.decode(errors="replace") if schema.encoding == "ros2msg" else ""
            yield PackedMessage(channel.topic, normalise_type(schema.name), text, message.log_time, message.data)


@dataclass
class _Registry:
    """Schemas and channels that a file has named so far, and the index of its chunks."""

    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)
    chunks: list[Any] = field(default_factory=list)

    def add(self, record: Any) -> None:
        """Add a record, if it is one of these."""
        from mcap.records import Channel, ChunkIndex, Schema

        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, ChunkIndex):
            self.chunks.append(record)

    def find(self, message: Any) -> tuple[Any, Any, Any] | None:
        """Return schema and channel with a message, if it holds signals of joints."""
        channel = self.channels.get(message.channel_id)
        schema = None if channel is None else self.schemas.get(channel.schema_id)
        if channel is None or schema is None or channel.message_encoding != "cdr":
            return None
        return (schema, channel, message) if normalise_type(schema.name) in KNOWN else None

    def refuse_other_encodings(self) -> None:
        """Refuse a file that holds no signals of joints, but messages that are not written as those of ROS."""
        others = {channel.message_encoding for channel in self.channels.values()} - {"cdr"}
        if others:
            raise RecordingError(
                f"The messages of the file are written in {' and '.join(sorted(others))}; only those of ROS (cdr) are "
                "read. Write them as a line of JSON each: mcap cat --json FILE > run.jsonl.",
                title=TITLE,
            )


class _McapFile:
    def __init__(self, file: BoundedFile) -> None:
        self._file = file
        self._unpacked = UnpackedSize(file.size)

    def read_messages(self) -> Iterator[tuple[Any, Any, Any]]:
        """Yield schema, channel and message of the messages that hold signals of joints."""
        summary = self._read_summary()
        # A file that was written in a stream, or cut off, may have no index of its chunks.
        return self._read_in_order() if summary is None or not summary.chunks else self._read_by_index(summary)

    def _read_summary(self) -> _Registry | None:
        """Return what the end of the file says of all of it; None if it says nothing."""
        from mcap.records import Chunk, Footer
        from mcap.stream_reader import StreamReader

        file: Any = self._file
        file.seek(max(file.size - _MAGIC, 0))
        if file.read(_MAGIC) != _END:
            raise ValueError("its end is missing, because the recorder did not close it; repair it with mcap recover")
        file.seek(max(file.size - _FOOTER - _MAGIC, 0))
        footer = next(StreamReader(file, skip_magic=True, emit_chunks=True).records)
        if not isinstance(footer, Footer):
            raise ValueError("it has no footer, because the recorder did not close it; repair it with mcap recover")
        if footer.summary_start == 0:
            return None
        file.seek(footer.summary_start)
        summary = _Registry()
        for record in StreamReader(file, skip_magic=True, emit_chunks=True).records:
            if isinstance(record, Chunk):
                raise ValueError("its summary cannot be read; repair it with mcap recover")
            summary.add(record)
        return summary

    def _read_by_index(self, summary: _Registry) -> Iterator[tuple[Any, Any, Any]]:
        """Yield the known messages by their time, chunk by chunk.

        The package's own reader puts every message into a heap, which takes longer than to unpack it, and those of
        other topics, images among them. Here what is of no later time than all later chunks is given, whole chunks
        mostly.
        """
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk, Message

        known_channels = {
            key
            for key, channel in summary.channels.items()
            if channel.schema_id in summary.schemas and normalise_type(summary.schemas[channel.schema_id].name) in KNOWN
        }
        if not known_channels:
            summary.refuse_other_encodings()
        chunks = sorted(summary.chunks, key=lambda index: (index.message_start_time, index.chunk_start_offset))
        # A file without indices of messages does not say which channels are in a chunk.
        chunks = [
            index
            for index in chunks
            if not index.message_index_offsets or known_channels & index.message_index_offsets.keys()
        ]
        messages: list[Any] = []
        file: Any = self._file
        for chunk, following in zip_longest(chunks, chunks[1:]):
            file.seek(chunk.chunk_start_offset + _RECORD_HEAD)
            records = self._unpack(Chunk.read(ReadDataStream(file)))
            messages += [
                message for message in records if isinstance(message, Message) and message.channel_id in known_channels
            ]
            messages.sort(key=lambda message: message.log_time)
            until = len(messages)
            if following is not None:
                # Later chunks may hold messages from their start time on: earlier ones are in their final order.
                until = bisect_right(messages, following.message_start_time, key=lambda message: message.log_time)
            yield from filter(None, map(summary.find, messages[:until]))
            del messages[:until]

    def _read_in_order(self) -> Iterator[tuple[Any, Any, Any]]:
        """Yield the known messages as they stand in the file, put in order among their neighbours."""
        from mcap.records import Chunk, Message
        from mcap.stream_reader import StreamReader

        file: Any = self._file
        file.seek(0)
        registry = _Registry()
        waiting: list[tuple[int, int, tuple[Any, Any, Any]]] = []
        number = count()
        for stored in StreamReader(file, emit_chunks=True).records:
            records: list[Any] = self._unpack(stored) if isinstance(stored, Chunk) else [stored]
            for record in records:
                registry.add(record)
                joint_message = registry.find(record) if isinstance(record, Message) else None
                if joint_message is not None:
                    # The running number keeps messages of one time in the order of the file, and spares comparing
                    # them.
                    heapq.heappush(waiting, (record.log_time, next(number), joint_message))
                if len(waiting) > _AHEAD:
                    yield heapq.heappop(waiting)[2]
        if not next(number):
            registry.refuse_other_encodings()
        while waiting:
            yield heapq.heappop(waiting)[2]

    def _unpack(self, chunk: Any) -> list[Any]:
        """Return the records of a chunk, unpacked within its limits before the package takes them apart."""
        from mcap.stream_reader import breakup_chunk

        size = chunk.uncompressed_size if chunk.compression else len(chunk.data)
        check_chunk(size, "A chunk of the file")
        content = _decompress(chunk.compression, chunk.data, size)
        if len(content) > size:
            raise ValueError(f"a chunk unpacks to more than the {size} bytes that the file declares")
        # Counted as it comes: an index may name one chunk many times.
        self._unpacked.add(len(content))
        return list(breakup_chunk(replace(chunk, compression="", data=content)))


def _decompress(compression: str, data: bytes, size: int) -> bytes:
    """Return the unpacked bytes, at most one more than `size`, which then shows that there are too many."""
    if compression == "zstd":
        from zstandard import ZstdDecompressor

        with ZstdDecompressor().stream_reader(data) as stream:
            content: bytes = stream.read(size + 1)
            return content
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        unpacked: bytes = LZ4FrameDecompressor().decompress(data, size + 1)
        return unpacked
    return data
