"""HDF5, and MAT files of version 7.3, which are HDF5 with the axes the other way round."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dynident.arrays import FloatArray
from dynident.recordings.formats.arrays import ArrayFileSource, StoredArray
from dynident.recordings.types import RecordingError


def hdf5_source(path: Path) -> ArrayFileSource:
    """Open an HDF5 file; its data sets, in groups or not, are read in parts.

    Raises
    ------
    RecordingError
        For a file that cannot be read.
    """
    import h5py

    found: list[StoredArray] = []
    try:
        file = h5py.File(path, "r")

        def keep(name: str, item: Any) -> None:
            if not isinstance(item, h5py.Dataset) or name.startswith("#"):
                return
            if item.dtype.names and item.ndim == 1:
                found.extend(_field(name, field, item) for field in item.dtype.names)
            elif item.dtype.kind in "fiub":
                found.append(_whole(name, item))

        file.visititems(keep)
    except OSError as error:
        raise RecordingError(f"The file cannot be read as HDF5: {error}", title="Unreadable file") from error
    return ArrayFileSource(found)


def _whole(name: str, item: Any) -> StoredArray:
    # Columns of one row, as MATLAB keeps a vector, are vectors.
    flat = item.ndim == 2 and 1 in item.shape

    def read(first: int, last: int, axis: int) -> FloatArray:
        if flat:
            part = item[first:last, 0] if item.shape[1] == 1 else item[0, first:last]
        else:
            part = item[first:last] if axis == 0 else item[:, first:last].T
        return np.asarray(part, dtype=np.float64)

    return StoredArray(name, (max(item.shape),) if flat else tuple(item.shape), read)


def _field(name: str, field: str, item: Any) -> StoredArray:
    def read(first: int, last: int, axis: int) -> FloatArray:
        return np.asarray(item[first:last][field], dtype=np.float64)

    return StoredArray(f"{name}.{field}", tuple(item.shape), read)
