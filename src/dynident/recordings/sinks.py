"""Where conditioned rows are written to: the canonical Parquet file, or arrays."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynident.array_types import FloatArray
from dynident.recordings.arrow import from_numbers
from dynident.recordings.recording import Recording
from dynident.recordings.segmenting import GridRows
from dynident.recordings.sources import METADATA_KEY, describe_recording, name_stored_columns

ROW_GROUP = 65536


class ArraySink:
    """Keeps the rows in memory."""

    def __init__(self) -> None:
        self._parts: list[FloatArray] = []

    def write(self, rows: GridRows) -> None:
        """Append rows."""
        self._parts.append(rows.values)

    def join_values(self) -> FloatArray:
        """Return all rows (m, c)."""
        return self._parts[0] if len(self._parts) == 1 else np.concatenate(self._parts)


class ParquetSink:
    """Writes rows as columns t, segment, q_<joint>, tau_<joint>, … in row groups of moderate size."""

    def __init__(self, path: Path, joint_names: tuple[str, ...], kinds: tuple[str, ...]) -> None:
        names = [name for kind in kinds for name in name_stored_columns(kind, joint_names)]
        fields = [("t", pa.float64()), ("segment", pa.int64()), *((name, pa.float64()) for name in names)]
        self._schema = pa.schema(fields)
        # Measured numbers do not repeat: a dictionary would only cost.
        self._writer = pq.ParquetWriter(path, self._schema, compression="snappy", use_dictionary=["segment"])
        self._waiting: list[GridRows] = []
        self._n_waiting = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.close()

    def write(self, rows: GridRows) -> None:
        """Append rows."""
        self._waiting.append(rows)
        self._n_waiting += len(rows.t)
        # Many small groups are slow to read: rows wait until they fill one.
        if self._n_waiting >= ROW_GROUP:
            self._flush()

    def describe(self, recording: Recording) -> None:
        """Add the description of the recording to the file, after the last row."""
        self._flush()
        self._writer.add_key_value_metadata({METADATA_KEY: describe_recording(recording)})

    def _flush(self) -> None:
        if not self._n_waiting:
            return
        t = np.concatenate([rows.t for rows in self._waiting])
        label = np.concatenate([np.full(len(rows.t), rows.label, dtype=np.int64) for rows in self._waiting])
        values = np.concatenate([rows.values for rows in self._waiting])
        columns = [from_numbers(t), from_numbers(label), *(from_numbers(column) for column in values.T)]
        self._writer.write_table(pa.Table.from_arrays(columns, schema=self._schema), row_group_size=ROW_GROUP)
        self._waiting, self._n_waiting = [], 0
