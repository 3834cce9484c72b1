"""Where the rows of a recording are read from: the canonical Parquet file, or arrays."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynident.arrays import FloatArray
from dynident.recordings.arrow import open_parquet_stream, to_floats
from dynident.recordings.types import WRENCH_NAMES, Recording, RecordingError, Segment, StoredRows

METADATA_KEY = b"dynident.recording"
LAYOUT_VERSION = 1


@dataclass(frozen=True, eq=False)
class ArraySource:
    """Rows held in memory: q, tau (m, n); temperature, command (m, n) and the base's wrench (m, 6) or None."""

    q: FloatArray
    tau: FloatArray
    temperature: FloatArray | None = None
    wrench: FloatArray | None = None
    command: FloatArray | None = None

    def rows(self, first: int, length: int, block_length: int) -> Iterator[StoredRows]:
        """Yield the rows as one block: they are in memory anyway."""
        part = slice(first, first + length)
        optional = (_cut_values(values, part) for values in (self.temperature, self.wrench, self.command))
        yield StoredRows(self.q[part], self.tau[part], *optional)


def _cut_values(values: FloatArray | None, part: slice) -> FloatArray | None:
    return None if values is None else values[part]


@dataclass(frozen=True)
class ParquetSource:
    """Rows of a canonical Parquet file, read row group by row group."""

    path: Path
    joint_names: tuple[str, ...]
    has_temperature: bool = False
    has_wrench: bool = False
    has_command: bool = False

    def rows(self, first: int, length: int, block_length: int) -> Iterator[StoredRows]:
        """Yield `length` rows from row `first` on in blocks of at most `block_length`."""
        heat = name_stored_columns("temperature", self.joint_names) if self.has_temperature else ()
        wrench = name_stored_columns("wrench", self.joint_names) if self.has_wrench else ()
        q, tau = (name_stored_columns(kind, self.joint_names) for kind in ("q", "tau"))
        command = name_stored_columns("q_command", self.joint_names) if self.has_command else ()
        columns = [*q, *tau, *heat, *wrench, *command]
        with open_parquet_stream(self.path) as file:
            groups, skipped = _find_row_groups(file.metadata, first, length)
            skip, n_left = first - skipped, length
            for batch in file.iter_batches(block_length, row_groups=groups, columns=columns, use_threads=False):
                part = batch.slice(skip, n_left)
                skip = max(0, skip - batch.num_rows)
                if not part.num_rows:
                    continue
                n_left -= part.num_rows
                yield StoredRows(
                    stack_columns(part, q),
                    stack_columns(part, tau),
                    stack_columns(part, heat) if heat else None,
                    stack_columns(part, wrench) if wrench else None,
                    stack_columns(part, command) if command else None,
                )
                if not n_left:
                    return


def name_stored_columns(kind: str, joint_names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns of a kind of signal in the canonical file."""
    return WRENCH_NAMES if kind == "wrench" else tuple(f"{kind}_{joint}" for joint in joint_names)


def stack_columns(batch: pa.RecordBatch, columns: Sequence[str]) -> FloatArray:
    """Return the named columns side by side (m, len(columns)), each row contiguous."""
    result = np.empty((batch.num_rows, len(columns)))
    for index, column in enumerate(columns):
        result[:, index] = to_floats(batch.column(column))
    return result


def _find_row_groups(metadata: pq.FileMetaData, first: int, length: int) -> tuple[list[int], int]:
    """Return the row groups that hold the rows, and how many rows precede them."""
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


def describe_recording(recording: Recording) -> bytes:
    """Return what a canonical file says of itself besides its rows, as JSON."""
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
        "has_wrench": recording.has_wrench,
        "has_command": recording.has_command,
        "joints_without_torque": recording.joints_without_torque,
    }
    return json.dumps(content).encode()


def open_recording(path: Path | str) -> Recording:
    """Open a canonical recording that `import_recording` has stored.

    Parameters
    ----------
    path : path

    Returns
    -------
    Recording
        Its rows stay in the file and are read when needed.

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
        source=ParquetSource(
            path,
            joint_names,
            content["has_temperature"],
            content.get("has_wrench", False),
            content.get("has_command", False),
        ),
        windows=tuple((start, end) for start, end in content["windows"]),
        role=content["role"],
        payload=content["payload"],
        has_temperature=content["has_temperature"],
        path=path,
        has_wrench=content.get("has_wrench", False),
        has_command=content.get("has_command", False),
        joints_without_torque=tuple(content.get("joints_without_torque", ())),
    )
