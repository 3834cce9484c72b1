"""Check how an HDF5 data set is stored, and refuse it before a byte of it is read if that is not plainly in its file.

The HDF5 library trusts what a file says of itself: it opens other files, allocates what a chunk is said to unpack to,
and ends the process at some damages.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from dynident.recordings.file_limits import LARGEST_CHUNK, TITLE, check_chunk
from dynident.recordings.types import RecordingError

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
    file_size : int
        Bytes.

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
        which = f"the filter {unknown[0]}" if unknown else "one filter twice"
        raise _unusable_data_error(
            name, f"is stored with {which}; known are {', '.join(_FILTERS.values())}, each once (h5repack -f GZIP=4)"
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

    item.id.chunk_iter(inspect_chunk)
    if wrong:
        info = wrong[0]
        raise _unusable_data_error(
            name,
            f"is damaged: a chunk is said to be {info.size} bytes at byte {info.byte_offset} of {file_size}, where "
            f"{largest} are the most",
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
            name, f"has a chunk that unpacks to more than the {chunk} bytes that it is said to hold"
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
