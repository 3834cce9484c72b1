"""NumPy's own files: .npy, mapped and not read, and .npz."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynident.arrays import FloatArray
from dynident.recordings.formats.arrays import ArrayFileSource, StoredArray
from dynident.recordings.types import RecordingError


def numpy_source(path: Path, name: str) -> ArrayFileSource:
    """Open a .npy file (an array of numbers, or of records with named fields) or a .npz archive of arrays.

    Raises
    ------
    RecordingError
        For a file that NumPy cannot read, or that holds Python objects.
    """
    try:
        if name == "npy":
            whole = np.load(path, mmap_mode="r", allow_pickle=False)
            if whole.dtype.names:
                return ArrayFileSource([memory_array(field, whole[field]) for field in whole.dtype.names])
            return ArrayFileSource([memory_array("column", whole)])
        with np.load(path, allow_pickle=False) as archive:
            # Each is read from the archive whenever it is asked for.
            arrays = [(key, archive[key]) for key in archive.files]
        return ArrayFileSource([memory_array(key, values) for key, values in arrays if values.dtype.kind in "fiub"])
    except (ValueError, OSError, EOFError, KeyError) as error:
        raise RecordingError(f"The file cannot be read as {name}: {error}", title="Unreadable file") from error


def memory_array(name: str, values: FloatArray) -> StoredArray:
    """Give an array in memory, or mapped into it, as one of a file's."""

    def read(first: int, last: int, axis: int) -> FloatArray:
        return np.asarray(values[first:last] if axis == 0 else values[:, first:last].T, dtype=np.float64)

    return StoredArray(name, values.shape, read)
