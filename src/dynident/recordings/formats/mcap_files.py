"""Container of MCAP: messages chunk by chunk, with limits on what they unpack to."""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count, zip_longest
from pathlib import Path
from typing import Any

from dynident.recordings.file_size_limits import TITLE, BoundedFile, UnpackedSize, check_chunk
from dynident.recordings.formats.packed_messages import KNOWN, PackedMessage, normalise_type
from dynident.recordings.recording_metadata import RecordingError

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
