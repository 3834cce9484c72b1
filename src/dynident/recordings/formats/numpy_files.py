"""Reader of .npy and .npz."""

from __future__ import annotations

import zlib
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

from numpy.lib import format as numpy_format

from dynident.recordings.file_size_limits import (
    TITLE,
    BoundedFile,
    UnpackedParts,
    check_columns,
    check_unpacked,
    make_damaged_error,
)
from dynident.recordings.formats.array_files import (
    MOST_WORDS,
    ArrayFileSource,
    ArrayPlace,
    StoredArray,
    read_words,
)
from dynident.recordings.recording_metadata import RecordingError

_HEADERS = {(1, 0): numpy_format.read_array_header_1_0, (2, 0): numpy_format.read_array_header_2_0}
_LONGEST_WORD = 1024
"""Bytes of a name in a list."""
_NUMBERS = "fiub"
_BROKEN = (
    *(ValueError, TypeError, OSError, EOFError, KeyError, RuntimeError, MemoryError, OverflowError, SyntaxError),
    *(BadZipFile, TokenError, zlib.error),
)
"""What NumPy's and Python's readers raise of headers and archives that are damaged; a deep header is a MemoryError."""


class _ObjectsError(ValueError):
    """An array of Python objects."""


def open_numpy(path: Path, name: str) -> ArrayFileSource:
    """Open a .npy file or a .npz archive.

    Parameters
    ----------
    path : path
        Where the file lies.
    name : "npy" or "npz"
        An array of numbers (or of records with named fields), or an archive of arrays.

    Returns
    -------
    ArrayFileSource
        The arrays of one common length, as columns.

    Raises
    ------
    RecordingError
        For a file that NumPy did not write, or whose only arrays are of Python objects.
    """
    try:
        return ArrayFileSource(*_read_archive(path)) if name == "npz" else ArrayFileSource(_read_single(path))
    except _ObjectsError as error:
        raise RecordingError(str(error), title=TITLE) from error
    except _BROKEN as error:
        raise make_damaged_error(name, error) from error


def _read_single(path: Path) -> list[StoredArray]:
    file = path.open("rb")
    place = _locate_array(file, 0, path.stat().st_size)
    if place is None or place.kind.kind in "US":
        return []
    return _list_fields(place, "") if place.kind.names else [place.to_array("column")]


def _list_fields(place: ArrayPlace, prefix: str) -> list[StoredArray]:
    """Return the fields of numbers of an array of records."""
    if len(place.shape) != 1:
        return []
    fields = [field for field in place.kind.names or () if place.kind[field].base.kind in _NUMBERS]
    return [place.to_array(f"{prefix}{field}", field) for field in fields]


def _read_archive(path: Path) -> tuple[list[StoredArray], list[tuple[str, ...]]]:
    """Return the arrays of numbers, and the lists of words."""
    arrays: list[StoredArray] = []
    words: list[tuple[str, ...]] = []
    objects: _ObjectsError | None = None
    file = path.open("rb")
    with ZipFile(path) as archive:
        members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
        check_columns(len(members))
        compressed = [member for member in members if member.compress_type != ZIP_STORED]
        # No more than this is unpacked of a member, whatever it holds.
        size = sum(member.file_size for member in compressed)
        check_unpacked(size, path.stat().st_size)
        unpacked = UnpackedParts(size) if compressed else None
        for member in members:
            if member.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
                method = f"{member.filename} is compressed by a method that NumPy does not use: save it by np.savez."
                raise RecordingError(method, title=TITLE)
            with archive.open(member) as stream:
                if member.compress_type == ZIP_STORED or unpacked is None:
                    # The archive was opened at it, and stands where it begins.
                    start = _find_start(file, member)
                    where: tuple[IO[bytes], int, int] = file, start, start + member.file_size
                else:
                    where = (unpacked.file, *unpacked.append(stream.read, member.file_size))
            try:
                place = _locate_array(*where)
            except _ObjectsError as error:
                # Beside arrays of numbers it is passed by, unread.
                objects = error
                continue
            if place is not None and place.kind.kind in "US":
                words.append(read_words(place.read_cells()))
            elif place is not None:
                called = member.filename.removesuffix(".npy")
                arrays += _list_fields(place, f"{called}.") if place.kind.names else [place.to_array(called)]
    if objects is not None and not arrays:
        raise objects
    return arrays, words


def _find_start(file: IO[bytes], member: ZipInfo) -> int:
    """Return the first byte of a member of an archive: behind its header, with two parts of any length."""
    file.seek(member.header_offset + 26)
    lengths = file.read(4)
    return member.header_offset + 30 + int.from_bytes(lengths[:2], "little") + int.from_bytes(lengths[2:], "little")


def _locate_array(file: IO[bytes], start: int, end: int) -> ArrayPlace | None:
    """Return where an array lies whose description begins at `start`; None for one of other things than numbers."""
    file.seek(start)
    bounded: Any = BoundedFile(file)
    version = numpy_format.read_magic(bounded)
    if version not in _HEADERS:
        raise ValueError(f"arrays of the format {version[0]}.{version[1]} are not supported")
    shape, by_columns, kind = _HEADERS[version](bounded)
    if kind.hasobject:
        objects = "The file contains Python objects, which are never loaded for safety: save arrays of numbers."
        raise _ObjectsError(objects)
    is_list = kind.kind in "US" and len(shape) == 1 and shape[0] <= MOST_WORDS and kind.itemsize <= _LONGEST_WORD
    if not kind.names and kind.kind not in _NUMBERS and not is_list:
        return None
    if any(size < 0 for size in shape):
        raise ValueError(f"its shape is {shape}")
    # A single number, such as a sampling time, has no axis.
    place = ArrayPlace(file, file.tell(), kind, shape or (1,), by_columns)
    if place.end > min(end, bounded.size):
        raise ValueError(f"its last numbers are missing: the shape is {shape}")
    return place
