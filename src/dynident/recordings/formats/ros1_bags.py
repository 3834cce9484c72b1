"""Bags of ROS 1: read by a package, whose chunks are bounded in what they may unpack to."""

from __future__ import annotations

import bz2
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dynident.recordings.file_limits import LARGEST_CHUNK, UnpackedSize, check_chunk
from dynident.recordings.formats.array_storage import BoundedFile
from dynident.recordings.formats.packed_messages import KNOWN, PackedMessage, normalise_type


def read_ros1_messages(path: Path) -> Iterator[PackedMessage]:
    """Yield the messages that hold signals of joints, by their time."""
    with _open_reader(path) as reader:
        connections = [candidate for candidate in reader.connections if normalise_type(candidate.msgtype) in KNOWN]
        if not connections:
            return
        for connection, stamp, data in reader.messages(connections=connections):
            text = connection.msgdef.data
            yield PackedMessage(connection.topic, normalise_type(connection.msgtype), text, stamp, bytes(data))


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
