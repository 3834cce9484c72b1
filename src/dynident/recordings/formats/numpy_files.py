"""NumPy's own files: .npy, and .npz archives, read in parts wherever their arrays lie."""

from __future__ import annotations

from pathlib import Path
from typing import IO
from zipfile import ZIP_STORED, BadZipFile, ZipFile

from numpy.lib import format as numpy_format

from dynident.recordings.formats.arrays import ArrayFileSource, StoredArray
from dynident.recordings.formats.stored import Place, unpacked
from dynident.recordings.types import RecordingError

_HEADERS = {(1, 0): numpy_format.read_array_header_1_0, (2, 0): numpy_format.read_array_header_2_0}
_NUMBERS = "fiub"


def numpy_source(path: Path, name: str) -> ArrayFileSource:
    """Open a .npy file (an array of numbers, or of records with named fields) or a .npz archive of arrays.

    Raises
    ------
    RecordingError
        For a file that NumPy did not write, or whose only arrays are of Python objects.
    """
    try:
        return ArrayFileSource(_archived(path) if name == "npz" else _single(path))
    except (ValueError, OSError, EOFError, KeyError, BadZipFile, NotImplementedError) as error:
        raise RecordingError(f"The file cannot be read as {name}: {error}", title="Unreadable file") from error


def _single(path: Path) -> list[StoredArray]:
    place = _place(path.open("rb"))
    if place is None:
        return []
    if place.kind.names:
        return [place.array(field, field) for field in place.kind.names if place.kind[field].base.kind in _NUMBERS]
    return [place.array("column")]


def _archived(path: Path) -> list[StoredArray]:
    found = []
    file = path.open("rb")
    with ZipFile(path) as archive:
        for member in archive.infolist():
            if not member.filename.endswith(".npy"):
                continue
            with archive.open(member) as stream:
                if member.compress_type == ZIP_STORED:
                    # The archive was opened at it, and stands where it begins.
                    place = _place(_at(file, member.header_offset))
                else:
                    place = _place(unpacked(stream.read, member.compress_size))
            if place is not None and not place.kind.names:
                found.append(place.array(member.filename.removesuffix(".npy")))
    return found


def _at(file: IO[bytes], header: int) -> IO[bytes]:
    """Go to the first byte of a member of an archive: behind its header, whose last two parts may be of any length."""
    file.seek(header + 26)
    lengths = file.read(4)
    file.seek(header + 30 + int.from_bytes(lengths[:2], "little") + int.from_bytes(lengths[2:], "little"))
    return file


def _place(file: IO[bytes]) -> Place | None:
    """Where an array lies whose description comes next; None for one of other things than numbers."""
    version = numpy_format.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"arrays of the format {version[0]}.{version[1]} are not known")
    shape, by_columns, kind = _HEADERS[version](file)
    if kind.hasobject or (not kind.names and kind.kind not in _NUMBERS):
        return None
    place = Place(file, file.tell(), kind, shape, by_columns)
    if place.end > file.seek(0, 2):
        raise ValueError("its last numbers are missing")
    return place
