"""The bytes of a text file: as they are, or decompressed on the way, with a bound on how many there may be."""

from __future__ import annotations

import io
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import IO, TYPE_CHECKING

import pyarrow as pa

from dynident.recordings.file_limits import MOST_TEXT, TITLE, UnpackedSize
from dynident.recordings.metadata import RecordingError

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer


class ProducedStream(io.RawIOBase):
    """A readable stream; a subclass produces the next bytes."""

    @abstractmethod
    def read_part(self, size: int) -> bytes:
        """Return the next bytes, at most `size`; none at the end."""

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        """Put the next bytes into a buffer; return how many."""
        view = memoryview(buffer)
        part = self.read_part(len(view))
        view[: len(part)] = part
        return len(part)


_COMPRESSIONS = ((b"\x1f\x8b", "gzip"), (b"\x28\xb5\x2f\xfd", "zstd"), (b"BZh", "bz2"), (b"\x04\x22\x4d\x18", "lz4"))
"""First bytes, and what Arrow calls the compression."""


class TextContent:
    """A file of text that can be read from its beginning as often as needed.

    Parameters
    ----------
    path : path
        Where it lies; compressed with gzip, zstd, bzip2 or lz4 it is unpacked as it is read.
    member : callable, optional
        Opens a part of the file instead of all of it.
    """

    def __init__(self, path: Path, member: Callable[[], IO[bytes]] | None = None) -> None:
        self._path, self._member = path, member
        self.compression = None if member is not None else detect_compression(path)

    @property
    def plain_path(self) -> Path | None:
        """The path of the file if its bytes are the text, else None."""
        return self._path if self._member is None and self.compression is None else None

    def open(self) -> IO[bytes]:
        """Open the text; decompressing to more than such files do raises `RecordingError` while it is read."""
        if self._member is not None:
            return self._member()
        if self.compression is None:
            return self._path.open("rb")
        # In large pieces: a call of the decompressor for every line would take most of the time.
        return io.BufferedReader(_DecompressedStream(self._path, self.compression), 1 << 20)

    def read_start(self, size: int) -> bytes:
        """Return the first bytes."""
        with self.open() as file:
            return file.read(size)


def detect_compression(path: Path) -> str | None:
    """Return the compression of a file by its first bytes; None if there is none."""
    with path.open("rb") as file:
        start = file.read(4)
    return next((name for first, name in _COMPRESSIONS if start.startswith(first)), None)


class _DecompressedStream(ProducedStream):
    """Decompresses a file, and counts the bytes."""

    def __init__(self, path: Path, compression: str) -> None:
        super().__init__()
        self._compression = compression
        self._size = UnpackedSize(path.stat().st_size, MOST_TEXT)
        self._file = pa.CompressedInputStream(pa.OSFile(str(path)), compression)

    def read_part(self, size: int) -> bytes:
        """Decompress the next bytes."""
        try:
            part: bytes = self._file.read(size)
        except (OSError, ValueError) as error:
            raise RecordingError(f"The file cannot be unpacked ({self._compression}): {error}", title=TITLE) from error
        # Counted as it comes: what a file unpacks to is not known before.
        self._size.add(len(part))
        return part

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()
