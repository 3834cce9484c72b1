"""MAT files up to version 7: arrays and structures of arrays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dynident.recordings.formats.arrays import ArrayFileSource, StoredArray
from dynident.recordings.formats.numpy_files import memory_array
from dynident.recordings.types import RecordingError


def matlab_source(path: Path) -> ArrayFileSource:
    """Open a MAT file; a field of a structure is called structure.field. Its version allows no reading in parts.

    Raises
    ------
    RecordingError
        For a file that cannot be read.
    """
    from scipy.io import loadmat

    try:
        whole: dict[str, Any] = loadmat(str(path), squeeze_me=True, struct_as_record=True)
    except (ValueError, TypeError, NotImplementedError, OSError) as error:
        raise RecordingError(f"The file cannot be read as MAT: {error}", title="Unreadable file") from error
    found = [part for name, value in whole.items() if not name.startswith("__") for part in _parts(name, value)]
    return ArrayFileSource(found)


def _parts(name: str, value: Any) -> Iterator[StoredArray]:
    value = np.asarray(value)
    if value.dtype.names and value.ndim == 0:
        for field in value.dtype.names:
            yield from _parts(f"{name}.{field}", value[field].item())
    elif value.dtype.kind in "fiub" and value.ndim:
        yield memory_array(name, value)
