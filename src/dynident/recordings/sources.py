"""Where the rows of a recording are kept: the canonical Parquet file, or arrays."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynident.recordings.arrow import streamed_parquet, to_floats
from dynident.recordings.types import FloatArray, Recording, RecordingError, Segment, StoredRows

METADATA_KEY = b"dynident.recording"
LAYOUT_VERSION = 1


@dataclass(frozen=True, eq=False)
class ArraySource:
    """Rows held in memory: q, tau (m, n), temperature (m, n) or None."""

    q: FloatArray
    tau: FloatArray
    temperature: FloatArray | None = None

    def rows(self, first: int, length: int, block_length: int) -> Iterator[StoredRows]:
        """Give the rows as one block: they are in memory anyway."""
        part = slice(first, first + length)
        yield StoredRows(self.q[part], self.tau[part], None if self.temperature is None else self.temperature[part])


@dataclass(frozen=True)
class ParquetSource:
    """Rows of a canonical Parquet file, read row group by row group."""

    path: Path
    joint_names: tuple[str, ...]
    has_temperature: bool = False

    def rows(self, first: int, length: int, block_length: int) -> Iterator[StoredRows]:
        """Stream `length` rows from row `first` on in blocks of at most `block_length`."""
        kinds = ("q", "tau", "temperature") if self.has_temperature else ("q", "tau")
        columns = [stored_column(kind, joint) for kind in kinds for joint in self.joint_names]
        n = len(self.joint_names)
        with streamed_parquet(self.path) as file:
            groups, skipped = _groups(file.metadata, first, length)
            skip, left = first - skipped, length
            for batch in file.iter_batches(block_length, row_groups=groups, columns=columns, use_threads=False):
                taken = batch.slice(skip, left)
                skip = max(0, skip - batch.num_rows)
                if not taken.num_rows:
                    continue
                left -= taken.num_rows
                yield StoredRows(
                    stacked(taken, columns[:n]),
                    stacked(taken, columns[n : 2 * n]),
                    stacked(taken, columns[2 * n :]) if self.has_temperature else None,
                )
                if not left:
                    return


def stored_column(kind: str, joint: str) -> str:
    """Name a joint's column in the canonical file."""
    return f"{kind}_{joint}"


def stacked(batch: pa.RecordBatch, columns: list[str]) -> FloatArray:
    """Give the named columns side by side (m, len(columns)), in the memory order that row-wise work likes."""
    result = np.empty((batch.num_rows, len(columns)))
    for index, column in enumerate(columns):
        result[:, index] = to_floats(batch.column(column))
    return result


def _groups(metadata: pq.FileMetaData, first: int, length: int) -> tuple[list[int], int]:
    """Give the row groups that hold the rows, and how many rows precede them."""
    groups: list[int] = []
    start = skipped = 0
    for index in range(metadata.num_row_groups):
        end = start + metadata.row_group(index).num_rows
        if start < first + length and end > first:
            if not groups:
                skipped = start
            groups.append(index)
        start = end
    return groups, skipped


def describe(recording: Recording) -> bytes:
    """Write what a canonical file says of itself besides its rows, as JSON."""
    content: dict[str, Any] = {
        "layout_version": LAYOUT_VERSION,
        "name": recording.name,
        "joint_names": recording.joint_names,
        "sampling_rate": recording.sampling_rate,
        "segments": [[s.first_row, s.length, s.start_time, s.label] for s in recording.segments],
        "windows": recording.windows,
        "role": recording.role,
        "payload": recording.payload,
        "has_temperature": recording.has_temperature,
    }
    return json.dumps(content).encode()


def open_recording(path: Path | str) -> Recording:
    """Open a canonical recording that `import_recording` has stored.

    Raises
    ------
    RecordingError
        If the file is no canonical recording.
    """
    path = Path(path)
    try:
        described = (pq.read_metadata(path).metadata or {}).get(METADATA_KEY)
    except pa.ArrowInvalid as error:
        raise RecordingError(f"{path.name} is no Parquet file: {error}") from error
    if described is None:
        raise RecordingError(f"{path.name} is not a stored recording; import it first.")
    content = json.loads(described)
    if content["layout_version"] != LAYOUT_VERSION:
        raise RecordingError(f"{path.name} has layout {content['layout_version']}, not {LAYOUT_VERSION}; import again.")
    joint_names = tuple(content["joint_names"])
    return Recording(
        name=content["name"],
        joint_names=joint_names,
        sampling_rate=content["sampling_rate"],
        segments=tuple(Segment(*segment) for segment in content["segments"]),
        source=ParquetSource(path, joint_names, content["has_temperature"]),
        windows=tuple((start, end) for start, end in content["windows"]),
        role=content["role"],
        payload=content["payload"],
        has_temperature=content["has_temperature"],
        path=path,
    )
