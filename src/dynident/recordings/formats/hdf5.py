"""Reader of HDF5 and MAT 7.3, with the checks of hostile files.

The HDF5 library trusts what a file says of itself: it opens other files, allocates what a chunk is said to unpack to,
and ends the process at some damages. A data set is therefore refused before a byte of it is read if it is not plainly
in its file.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.array_types import FloatArray
from dynident.recordings.file_size_limits import (
    DEEPEST,
    LARGEST_CHUNK,
    MOST_OBJECTS,
    TITLE,
    check_chunk,
    check_columns,
    check_unpacked,
    make_damaged_error,
)
from dynident.recordings.formats.array_files import (
    FEWEST_ROWS,
    MOST_WORDS,
    ArrayFileSource,
    StoredArray,
    count_name,
    read_words,
)
from dynident.recordings.formats.matlab import describe_object, describe_rows
from dynident.recordings.recording_metadata import RecordingError

if TYPE_CHECKING:
    import h5py

_GZIP, _SHUFFLE, _FLETCHER, _SZIP, _LZF = 1, 2, 3, 4, 32000
_FILTERS = {_GZIP: "gzip", _SHUFFLE: "shuffle", _FLETCHER: "fletcher32", _SZIP: "szip", _LZF: "lzf"}
_FLETCHER_BYTES = 4
_GROWTH = {_GZIP: 1032, _LZF: 90}
"""Times that a byte may become under each compression (deflate: 258 bytes from 2 bits; LZF: 264 from 3)."""


def check_hdf5_storage(name: str, item: h5py.Dataset, file_size: int) -> None:
    """Refuse a data set whose numbers are not in its file, or are stored in a way that could harm its reader.

    Parameters
    ----------
    name : str
        Of the data set, for the message.
    item : h5py.Dataset
        The data set, of which nothing is read.
    file_size : int
        Bytes of the file as it is stored.

    Raises
    ------
    RecordingError
        With the name, what is wrong and what to do.
    """
    properties = item.id.get_create_plist()
    if properties.get_external_count() or item.external:
        raise _external_data_error(name, "external storage")
    if item.is_virtual:
        raise _external_data_error(name, "a virtual data set")
    filters = [properties.get_filter(k)[0] for k in range(properties.get_nfilters())]
    unknown = [code for code in filters if code not in _FILTERS]
    if unknown or len(set(filters)) < len(filters):
        which = f"the filter {unknown[0]}" if unknown else "the same filter twice"
        raise _unusable_data_error(
            name,
            f"is stored with {which}; supported are {', '.join(_FILTERS.values())}, each once (h5repack -f GZIP=4)",
        )
    if item.chunks is None:
        return
    chunk = math.prod(item.chunks) * item.dtype.itemsize
    check_chunk(chunk, f"A chunk of {name}")
    _check_chunks(name, item, filters, chunk, file_size)


def _check_chunks(name: str, item: Any, filters: list[int], chunk: int, file_size: int) -> None:
    """Check where stored chunks are said to lie, and how long they are, before the library follows it."""
    most = math.prod(-(-size // part) for size, part in zip(item.shape, item.chunks, strict=True))
    compressed = any(code in _GROWTH or code == _SZIP for code in filters)
    # Deflate, the worst of them, makes five bytes more of 32 kB that it cannot shrink.
    largest = chunk + _FLETCHER_BYTES + (chunk // 100 + 64 if compressed else 0)
    least = _FLETCHER_BYTES + 1 if _FLETCHER in filters else 1
    number = 0
    suspects: list[Any] = []
    wrong: list[Any] = []

    def inspect_chunk(info: Any) -> bool | None:
        nonlocal number
        number += 1
        fits = least <= info.size <= largest and info.byte_offset + info.size <= file_size
        if not fits or number > most:
            wrong.append(info)
            return True  # ends the iteration
        if any(info.size * _GROWTH.get(code, 0) > 4 * LARGEST_CHUNK for code in filters) or _SZIP in filters:
            # Only these could unpack to more than their chunk: to look into every chunk would read the whole file.
            suspects.append(info)
        return None

    # This reads the index of the chunks alone, and none of them.
    item.id.chunk_iter(inspect_chunk)
    if wrong:
        info = wrong[0]
        raise _unusable_data_error(
            name,
            f"is damaged: the file says that a chunk has {info.size} bytes at byte {info.byte_offset} of {file_size}, "
            f"but a chunk can have at most {largest}",
        )
    for info in suspects:
        _check_compressed(name, item, filters, info, chunk)


def _check_compressed(name: str, item: Any, filters: list[int], info: Any, chunk: int) -> None:
    """Refuse a chunk that would unpack to more than it may: the library allocates whatever comes."""
    # The mask says which filters were left out when this chunk was written.
    mask, data = item.id.read_direct_chunk(info.chunk_offset)
    applied = [code for k, code in enumerate(filters) if not mask >> k & 1]
    last = next((code for code in reversed(applied) if code != _FLETCHER), None)
    unpacked = chunk
    if last == _SZIP:
        unpacked = int.from_bytes(data[:4], "little")
    elif last == _GZIP:
        unpacked = _count_inflated_bytes(data, chunk + _FLETCHER_BYTES + 1)
    elif last == _LZF:
        unpacked = len(data) * _GROWTH[_LZF]
    if unpacked > (4 * LARGEST_CHUNK if last == _LZF else chunk + _FLETCHER_BYTES):
        raise _unusable_data_error(
            name, f"has a chunk that unpacks to more than the {chunk} bytes that the file declares"
        )


def _count_inflated_bytes(data: bytes, most: int) -> int:
    """Return the number of bytes, up to `most`, that a stream of deflate unpacks to."""
    inflate: Callable[[bytes, int], bytes]
    stream = zlib.decompressobj()
    inflate, size = stream.decompress, 0
    try:
        while size < most and not stream.eof:
            part = inflate(data, min(most - size, 2**20))
            data = stream.unconsumed_tail
            size += len(part)
            if not part and not data:
                break
    except zlib.error:
        pass  # the library says so when it comes to it
    return size


def _external_data_error(name: str, how: str) -> RecordingError:
    return RecordingError(
        f"{name} keeps its data in another file ({how}); write it into this file (h5repack -l {name}:CONTI in.h5 "
        "out.h5).",
        pointer=name,
        title="Data in another file",
    )


def _unusable_data_error(name: str, reason: str) -> RecordingError:
    return RecordingError(f"{name} {reason}.", pointer=name, title=TITLE)


_NUMBERS = "fiub"
_LONGEST_WORD = 1024
"""Bytes of a word of fixed length, as the file states them; what one of another kind takes lies in the file."""
_MOST_CELLS = 1000
"""Cells of a list that are looked into; longer ones are of texts or states."""
_BROKEN = (OSError, RuntimeError, TypeError, ValueError, KeyError, NotImplementedError)
"""What h5py raises of files that are damaged, or hold types that NumPy has not."""


def open_hdf5(path: Path) -> ArrayFileSource:
    """Open an HDF5 file; its data sets, in groups or not, are read in parts.

    Nothing outside of the file is read: data sets that keep their numbers in other files, and links to other files,
    are refused.

    Parameters
    ----------
    path : path
        Where the file lies.

    Returns
    -------
    ArrayFileSource
        The arrays of one common length, as columns.

    Raises
    ------
    RecordingError
        For a file that cannot be read, or a data set that is not plain data in this file (its name, and what to do).
    """
    import h5py

    try:
        file = h5py.File(path, "r")
        unread: dict[str, str] = {}
        stored = list(_find_datasets(file, unread))
        words = [read_words(item[()]) for _, item in stored if not _has_numbers(item)]
        datasets = [(name, item) for name, item in stored if _has_numbers(item)]
        check_columns(len(datasets))
        size = path.stat().st_size
        # Sizes as the file states them, before a byte of data is read.
        check_unpacked(sum(math.prod(item.shape) * item.dtype.itemsize for _, item in datasets), size)
        arrays: list[StoredArray] = []
        for name, item in datasets:
            check_hdf5_storage(name, item, size)
            arrays += _list_arrays(name, item)
    except RecordingError:
        raise
    except _BROKEN as error:
        raise make_damaged_error("HDF5", error) from error
    return ArrayFileSource(arrays, words, unread)


def _find_datasets(file: Any, unread: dict[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield the data sets of numbers, or of records with some, with their paths; each object once.

    Variables of MATLAB that cannot be read, and what to do about each, go to `unread`.
    """
    import h5py

    # Containers, with what stands before and behind their members' names.
    waiting: list[tuple[str, str, int, Any]] = [("", "", 0, file)]
    addresses: set[int] = set()
    n_members = 0
    while waiting:
        before, behind, depth, container = waiting.pop()
        is_group = isinstance(container, h5py.Group)
        members = _list_members(before, container) if is_group else _list_cells(before, behind, container)
        datasets: list[tuple[str, Any]] = []
        for name, kind, address, open_member in members:
            n_members += 1
            if n_members > MOST_OBJECTS or depth > DEEPEST:
                raise RecordingError(
                    f"The file has more than {MOST_OBJECTS} groups and data sets, or groups more than {DEEPEST} "
                    "levels deep; export only the signals of the joints.",
                    title=TITLE,
                )
            # Groups may hold each other by hard links, in a circle: addresses tell what was visited.
            if address in addresses:
                continue
            addresses.add(address)
            if kind == h5py.h5o.TYPE_GROUP:
                waiting.append((f"{name}/", "", depth + 1, open_member()))
            elif kind == h5py.h5o.TYPE_DATASET:
                datasets.append((name, open_member()))
        shapes = [item.shape for _, item in datasets if h5py.check_ref_dtype(item.dtype) is h5py.Reference]
        # The fields of an array of structures are as many lists of cells, all of one shape.
        is_array = is_group and before != "" and len(shapes) == len(datasets) > 1 and len(set(shapes)) == 1
        if is_array and math.prod(shapes[0] or ()) >= FEWEST_ROWS:
            name = before.removesuffix("/")
            unread[name] = describe_rows(name, "an array of structures", f"{name}.q")
        for name, item in datasets:
            if _has_references(item):
                field = f"/{name.removeprefix(before)}" if is_array else ""
                waiting.append((before.removesuffix("/") if is_array else name, field, depth + 1, item))
            elif "MATLAB_object_decode" in item.attrs:
                unread[name] = describe_object(name, _read_matlab_class(item).decode("latin-1"))
            elif _has_numbers(item) or _has_words(item):
                yield name, item


_Member = tuple[str, int, int, Callable[[], Any]]
"""The path of an object, what it is, its address, and what opens it."""


def _list_members(prefix: str, group: Any) -> Iterator[_Member]:
    """Yield what a group holds in this file."""
    import h5py

    for key in group:
        if isinstance(key, bytes):
            raise RecordingError(f"The name {key[:80]!r} is not UTF-8 text; rename it.", title=TITLE)
        name = prefix + key
        link = group.get(key, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise RecordingError(
                f"{name} is a link to another file ({link.filename!r}); write its data into this file "
                "(h5copy, or h5repack after h5py's copy).",
                pointer=name,
                title="Data in another file",
            )
        # A soft link names what stands elsewhere in the file, and is met there.
        if isinstance(link, h5py.HardLink) and not name.startswith("#"):
            yield name, *_kind_and_address(group, key), partial(group.__getitem__, key)


def _list_cells(before: str, behind: str, item: Any) -> Iterator[_Member]:
    """Yield what the cells of MATLAB's arrays refer to, called as in its older files: runs{2}.q is runs2/q."""
    import h5py

    for number, reference in enumerate(np.ravel(item[()]), start=1):
        if not reference:
            continue
        target = h5py.h5o.get_info(h5py.h5r.dereference(reference, item.id))
        name = f"{count_name(before, number)}{behind}"
        yield name, target.type, target.addr, partial(item.file.__getitem__, reference)


def _kind_and_address(group: Any, key: str) -> tuple[int, int]:
    """Return what an object is, and where it lies, without opening it."""
    import h5py

    info = h5py.h5o.get_info(group.id, group._e(key))
    return info.type, info.addr


def _has_words(item: Any) -> bool:
    """Return whether a data set is a short list of text that lies in this file as it is."""
    import h5py

    return (
        item.shape is not None
        and len(item.shape) == 1
        and 1 < item.shape[0] <= MOST_WORDS
        and h5py.check_string_dtype(item.dtype) is not None
        and item.dtype.itemsize <= _LONGEST_WORD
        and item.chunks is None
        and item.external is None
        and not item.is_virtual
    )


def _has_references(item: Any) -> bool:
    """Return whether a data set is a short list of objects of this file, as MATLAB keeps cells."""
    import h5py

    return (
        item.shape is not None
        and h5py.check_ref_dtype(item.dtype) is h5py.Reference
        and math.prod(item.shape) <= _MOST_CELLS
        and item.chunks is None
        and item.external is None
        and not item.is_virtual
    )


def _has_numbers(item: Any) -> bool:
    if item.shape is None or "MATLAB_empty" in item.attrs or _is_matlab_text(item):  # nothing, or its size alone
        return False
    if item.dtype.names:
        return item.ndim == 1 and any(item.dtype[field].base.kind in _NUMBERS for field in item.dtype.names)
    return item.dtype.kind in _NUMBERS


def _is_matlab_text(item: Any) -> bool:
    """Return whether whole numbers are the letters of a text of MATLAB."""
    return item.dtype.kind == "u" and _read_matlab_class(item) == b"char"


def _read_matlab_class(item: Any) -> bytes:
    """Return what MATLAB calls a variable's class, such as char; nothing where that is no short word."""
    if "MATLAB_class" not in item.attrs:
        return b""
    attribute = item.attrs.get_id("MATLAB_class")
    is_short = attribute.dtype.kind == "S" and attribute.dtype.itemsize <= _LONGEST_WORD and attribute.shape == ()
    return bytes(item.attrs["MATLAB_class"]) if is_short else b""


def _list_arrays(name: str, item: Any) -> list[StoredArray]:
    if not item.dtype.names:
        return [_whole_array(name, item)]
    # Texts and nested records of a table are no signals.
    fields = [field for field in item.dtype.names if item.dtype[field].base.kind in _NUMBERS]
    return [_field_array(name, field, item) for field in fields]


def _whole_array(name: str, item: Any) -> StoredArray:
    # Columns of one row, as MATLAB keeps a vector, are vectors; so are pages of one row tables.
    axes = [axis for axis, size in enumerate(item.shape) if size > 1] or [0]
    flat = item.ndim == 2 and 1 in item.shape
    paged = item.ndim > 2 and len(axes) <= 2
    shape = tuple(item.shape[axis] for axis in axes) if flat or paged else tuple(item.shape) or (1,)

    def read(first: int, last: int, axis: int) -> FloatArray:
        if not item.shape:
            part = np.atleast_1d(item[()])
        elif flat or paged:
            place: list[int | slice] = [slice(None) if at in axes else 0 for at in range(item.ndim)]
            place[axes[axis]] = slice(first, last)
            part = item[tuple(place)]
            part = part if axis == 0 else part.T
        else:
            part = item[first:last] if axis == 0 else item[:, first:last].T
        return np.asarray(part, dtype=np.float64)

    return StoredArray(name, shape, read)


def _field_array(name: str, field: str, item: Any) -> StoredArray:
    inner = item.dtype[field].shape

    def read(first: int, last: int, axis: int) -> FloatArray:
        fields = item.fields(field)
        return np.asarray(fields[first:last] if axis == 0 else fields[:][:, first:last].T, dtype=np.float64)

    return StoredArray(f"{name}.{field}", (*item.shape, *inner), read)
