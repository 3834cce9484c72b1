"""Limits against hostile files, for all formats: columns, chunks, messages, nesting, unpacked size.

The limits stand here for all formats, each with its reason. They bound memory and disk; a file within all of them can
still be slow.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from typing import IO

from dynident.recordings.recording_metadata import RecordingError

MOST_COLUMNS = 10_000
"""Columns of a file. A humanoid of 60 joints with 20 signals each has 1,200."""

BLOCK_ROWS = 32_768
BLOCK_VALUES = 2**22
"""Rows of a block, and numbers of all its columns (32 MB): up to 128 columns have blocks of full length."""

LARGEST_CHUNK = 64 * 2**20
"""Bytes that unpack at once: a chunk of HDF5, of a bag or of MCAP. Loggers write chunks of 16 kB to 8 MB, and those
with images or point clouds some tens of MB."""

LARGEST_MESSAGE = 4 * 2**20
"""Bytes of a message with signals of joints: 10,000 columns with long names take 1.3 MB."""

LARGEST_OBJECT = 2**24
"""Characters of an object of JSON that holds all signals: as Python's numbers they take ten times as much memory."""

LARGEST_DEFINITION = 2**18
"""Characters that define a type of messages with all its parts. Those of ros2_control take 10,000."""

MOST_UNPACKED, MOST_TIMES = 2**28, 100
"""Bytes that any file may unpack to, and times its size that a larger one may: signals shrink to a tenth at the least,
what shrinks to a thousandth was made to fill a memory or a disk."""

MOST_TEXT = 2**25
"""The same of text, which is parsed as it is unpacked and takes a hundred times as long: 300,000 rows of 12 numbers."""

DEEPEST = 32
"""Groups, structures and types of messages inside each other; MATLAB's and ROS's own need fewer than ten."""

MOST_OBJECTS = 100_000
"""Groups and data sets that an HDF5 file is searched through."""

TITLE = "Unreadable file"

_REPAIRS = {
    "rosbag": "rosbag reindex FILE",
    "rosbag2": "ros2 bag reindex FOLDER",
    "mcap": "mcap recover FILE -o OTHER",
    "HDF5": "h5clear -s FILE",
}
"""Commands that close a file whose recorder was stopped."""


def make_damaged_error(kind: str, error: BaseException) -> RecordingError:
    """Return the error for a file that its reader does not understand: most such files are cut short.

    Parameters
    ----------
    kind : str
        The format.
    error : BaseException
        What the reader says; an error that names another reason is returned as it is.
    """
    if isinstance(error, RecordingError):
        return error
    repair = f"; a recorder that was stopped leaves files that `{_REPAIRS[kind]}` closes" if kind in _REPAIRS else ""
    text = str(error).rstrip(". ")
    return RecordingError(
        f"The file cannot be read as {kind}: {text}. Probably it is cut short or damaged: compare its size with that "
        f"of the original, and copy it again{repair}.",
        title=TITLE,
    )


def check_columns(number: int) -> None:
    """Refuse a file of more columns than any recording has."""
    if number > MOST_COLUMNS:
        raise RecordingError(
            f"The file has {number} columns; at most {MOST_COLUMNS} are read. If rows and columns are exchanged, "
            "transpose the table; otherwise export only the signals of the joints.",
            title=TITLE,
        )


def check_chunk(size: int, where: str) -> None:
    """Refuse a part of a file that unpacks to more at once than loggers write.

    Parameters
    ----------
    size : int
        Bytes that the part unpacks to.
    where : str
        Which part it is, for the message.

    Raises
    ------
    RecordingError
        For a part of more than `LARGEST_CHUNK` bytes.
    """
    if size > LARGEST_CHUNK:
        raise RecordingError(
            f"{where} unpacks to {size / 2**20:.0f} MB at once; at most {LARGEST_CHUNK >> 20} MB are read. Write the "
            "file in smaller chunks.",
            title=TITLE,
        )


def check_unpacked(size: int, file_size: int, smallest: int | None = None) -> None:
    """Refuse a file whose content is many times larger than the file, and than `smallest` bytes.

    Parameters
    ----------
    size : int
        Bytes that the file unpacks to.
    file_size : int
        Bytes of the file as it is stored.
    smallest : int, optional
        Bytes to which any file may unpack; `MOST_UNPACKED` where not given.

    Raises
    ------
    RecordingError
        For a file that unpacks to more.
    """
    most = max(MOST_UNPACKED if smallest is None else smallest, MOST_TIMES * file_size)
    if size > most:
        raise RecordingError(
            f"The content of the file unpacks to more than {most / 2**20:.0f} MB, from {file_size / 2**20:.3g} MB: "
            "signals do not compress so well. If the file is right, store it without compression.",
            title=TITLE,
        )


def choose_block_rows(columns: int) -> int:
    """Return how many rows are read at once of a file with so many columns."""
    # A wide file has shorter blocks: it is the number of values that takes memory.
    return max(1, min(BLOCK_ROWS, BLOCK_VALUES // max(columns, 1)))


class UnpackedSize:
    """Counts the bytes that a file has unpacked to.

    Parameters
    ----------
    file_size : int
        Bytes of the file as it is stored.
    smallest : int, optional
        Bytes to which any file may unpack; `MOST_UNPACKED` where not given.
    """

    def __init__(self, file_size: int, smallest: int | None = None) -> None:
        self._file_size, self._smallest, self._size = file_size, smallest, 0

    def add(self, size: int) -> None:
        """Count more bytes; raise `RecordingError` if a file of this size never unpacks to so many."""
        self._size += size
        check_unpacked(self._size, self._file_size, self._smallest)


class BoundedFile:
    """A file that is never asked for more bytes than it has left: Python would allocate whatever is requested.

    Parameters
    ----------
    file : binary file
        The open file.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.size = os.fstat(file.fileno()).st_size

    def read(self, size: int = -1) -> bytes:
        """Read at most so many bytes; all that are left if `size` is negative."""
        n_left = max(self.size - self._file.tell(), 0)
        return self._file.read(n_left if size < 0 else min(size, n_left))

    def readline(self, size: int = -1) -> bytes:
        """Read a line."""
        return self._file.readline(size)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a byte."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the position of the next byte."""
        return self._file.tell()

    def seekable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the number of the open file."""
        return self._file.fileno()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


_AT_ONCE = 2**20


class UnpackedParts:
    """The decompressed parts of a file, one behind another in a temporary file, where parts of them can be read.

    Parameters
    ----------
    size : int
        Bytes of all parts.

    Raises
    ------
    RecordingError
        The disk has no room for them.
    """

    def __init__(self, size: int) -> None:
        free = shutil.disk_usage(tempfile.gettempdir()).free
        if size > free:
            detail = f"The file unpacks to {size / 2**20:.0f} MB, but only {free / 2**20:.0f} MB are free on the disk."
            raise RecordingError(detail, title="Not enough disk space")
        self.file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - it is closed with the arrays that lie in it

    def append(self, read: Callable[[int], bytes], size: int) -> tuple[int, int]:
        """Unpack one more part.

        Parameters
        ----------
        read : callable
            Gives the next bytes, at most so many, and none at the end.
        size : int
            Bytes that it says to unpack to. `ValueError` where there are fewer; more are not read.

        Returns
        -------
        int, int
            Its first byte, and the first one behind it.
        """
        start, n_left = self.file.seek(0, 2), size
        # In pieces, so that memory does not grow with the file.
        while n_left and (part := read(min(_AT_ONCE, n_left))):
            n_left -= len(part)
            self.file.write(part)
        if n_left:
            raise ValueError("a compressed part ends too early")
        # Arrays are read by the file's number, past Python's buffer: what waits in it would be missing.
        self.file.flush()
        return start, start + size
