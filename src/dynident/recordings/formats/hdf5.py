"""HDF5, and MAT files of version 7.3, which are HDF5 with the axes the other way round."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dynident.arrays import FloatArray
from dynident.recordings.file_limits import DEEPEST, MOST_OBJECTS, TITLE, check_columns, check_unpacked
from dynident.recordings.formats.arrays import ArrayFileSource, StoredArray
from dynident.recordings.formats.hdf5_storage import check_hdf5_storage
from dynident.recordings.types import RecordingError

_NUMBERS = "fiub"
_BROKEN = (OSError, RuntimeError, TypeError, ValueError, KeyError, NotImplementedError)
"""What h5py raises of files that are damaged, or hold types that NumPy has not."""


def open_hdf5(path: Path) -> ArrayFileSource:
    """Open an HDF5 file; its data sets, in groups or not, are read in parts.

    Nothing outside of the file is read: data sets that keep their numbers in other files, and links to other files,
    are refused.

    Parameters
    ----------
    path : path

    Returns
    -------
    ArrayFileSource

    Raises
    ------
    RecordingError
        For a file that cannot be read, or a data set that is not plain data in this file (its name, and what to do).
    """
    import h5py

    try:
        file = h5py.File(path, "r")
        datasets = dict(_find_datasets(file))
        check_columns(len(datasets))
        size = path.stat().st_size
        # Sizes as the file states them, before a byte of data is read.
        check_unpacked(sum(math.prod(item.shape) * item.dtype.itemsize for item in datasets.values()), size)
        arrays: list[StoredArray] = []
        for name, item in datasets.items():
            check_hdf5_storage(name, item, size)
            arrays += _list_arrays(name, item)
    except RecordingError:
        raise
    except _BROKEN as error:
        raise RecordingError(f"The file cannot be read as HDF5: {error}", title=TITLE) from error
    return ArrayFileSource(arrays)


def _find_datasets(file: Any) -> Iterator[tuple[str, Any]]:
    """Yield the data sets of numbers, or of records with some, with their paths; each object once."""
    import h5py

    waiting: list[tuple[str, int, Any]] = [("", 0, file)]
    addresses: set[int] = set()
    while waiting:
        prefix, depth, group = waiting.pop()
        for key in group:
            if isinstance(key, bytes):
                raise RecordingError(f"The name {key[:80]!r} is no UTF-8 text; rename it.", title=TITLE)
            name = prefix + key
            link = group.get(key, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                raise RecordingError(
                    f"{name} is a link to another file ({link.filename!r}); write its data into this file "
                    "(h5copy, or h5repack after h5py's copy).",
                    pointer=name,
                    title="Data in another file",
                )
            if not isinstance(link, h5py.HardLink) or name.startswith("#"):
                continue  # a soft link names what stands elsewhere in the file, and is met there
            # Groups may hold each other by hard links, in a circle: addresses tell what was visited.
            kind, address = _kind_and_address(group, key)
            if address in addresses:
                continue
            addresses.add(address)
            if len(addresses) > MOST_OBJECTS or depth > DEEPEST:
                raise RecordingError(
                    f"The file has more than {MOST_OBJECTS} groups and data sets, or groups more than {DEEPEST} deep; "
                    "export the signals of the joints alone.",
                    title=TITLE,
                )
            if kind == h5py.h5o.TYPE_GROUP:
                waiting.append((f"{name}/", depth + 1, group[key]))
            elif kind == h5py.h5o.TYPE_DATASET and _has_numbers(item := group[key]):
                yield name, item


def _kind_and_address(group: Any, key: str) -> tuple[int, int]:
    """Return what an object is, and where it lies, without opening it."""
    import h5py

    info = h5py.h5o.get_info(group.id, group._e(key))
    return info.type, info.addr


def _has_numbers(item: Any) -> bool:
    if item.shape is None:  # an empty data space
        return False
    if item.dtype.names:
        return item.ndim == 1 and any(item.dtype[field].base.kind in _NUMBERS for field in item.dtype.names)
    return item.dtype.kind in _NUMBERS


def _list_arrays(name: str, item: Any) -> list[StoredArray]:
    if not item.dtype.names:
        return [_whole_array(name, item)]
    # Texts and nested records of a table are no signals.
    fields = [field for field in item.dtype.names if item.dtype[field].base.kind in _NUMBERS]
    return [_field_array(name, field, item) for field in fields]


def _whole_array(name: str, item: Any) -> StoredArray:
    # Columns of one row, as MATLAB keeps a vector, are vectors.
    flat = item.ndim == 2 and 1 in item.shape

    def read(first: int, last: int, axis: int) -> FloatArray:
        if flat:
            part = item[first:last, 0] if item.shape[1] == 1 else item[0, first:last]
        else:
            part = item[first:last] if axis == 0 else item[:, first:last].T
        return np.asarray(part, dtype=np.float64)

    return StoredArray(name, (max(item.shape),) if flat else tuple(item.shape), read)


def _field_array(name: str, field: str, item: Any) -> StoredArray:
    inner = item.dtype[field].shape

    def read(first: int, last: int, axis: int) -> FloatArray:
        fields = item.fields(field)
        return np.asarray(fields[first:last] if axis == 0 else fields[:][:, first:last].T, dtype=np.float64)

    return StoredArray(f"{name}.{field}", (*item.shape, *inner), read)
