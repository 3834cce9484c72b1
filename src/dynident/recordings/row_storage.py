"""Write and read a recording's canonical Parquet file, or keep its rows in arrays."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import from_numbers, open_parquet_stream, table_column_to_numbers, to_floats
from dynident.recordings.recording import WRENCH_NAMES, JointKind, Recording, SampleSource, Segment, StoredRows
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.uniform_segments import GridRows
from dynident.recordings.units import STORED_KINDS, find_our_unit

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


_TURNS: JointKind = "revolute"


@dataclass(frozen=True, eq=False)
class StoredSamples:
    """All samples of a recording, column by column.

    Parameters
    ----------
    columns : mapping of str to (m,)
        Samples by name of column.
    units : mapping of str to str
        Units of those columns that have one.
    """

    columns: Mapping[str, NDArray[np.generic]]
    units: Mapping[str, str]


def load_stored_samples(recording: Recording, kinds: Sequence[JointKind] = ()) -> StoredSamples:
    """Return the stored samples of a recording, unfiltered and evenly sampled, all of them in memory.

    Columns, (m,) each: t in s, segment (the label of the run), q_<joint> in rad or m, tau_<joint> in N m or N, and
    where the file had them dq_<joint> in rad/s or m/s, ddq_<joint> in rad/s^2 or m/s^2, q_command_<joint> in rad or m,
    temperature_<joint> in degC and the base's wrench in N and N m.

    Parameters
    ----------
    recording : Recording
        The checked recording.
    kinds : sequence of str
        Kinds of the joints, "revolute" or "prismatic". Empty: they are not known, and joints count as revolute.

    Returns
    -------
    StoredSamples
        All samples, and the units of their columns.
    """
    source = recording.source
    if isinstance(source, ParquetSource):
        table = pq.read_table(source.path)
        columns: dict[str, NDArray[np.generic]] = {
            name: table_column_to_numbers(table.column(name)) for name in table.column_names
        }
    else:
        columns = _read_columns(recording)
    return StoredSamples(columns, list_signal_units(columns, recording.joint_names, kinds))


def list_signal_units(
    columns: Mapping[str, object], joints: Sequence[str], kinds: Sequence[JointKind] = ()
) -> dict[str, str]:
    """Return the units of those columns that have one.

    Parameters
    ----------
    columns : mapping
        Names such as t, q_<joint>, dq_<joint>; what they map to does not matter.
    joints : sequence of str
        Names of the n joints, in the robot's order.
    kinds : sequence of str
        Kinds of the joints, "revolute" or "prismatic". Empty: joints count as revolute.

    Returns
    -------
    dict
        Units by name of column.
    """
    units = {"t": find_our_unit("t", None)}
    units |= dict.fromkeys(WRENCH_NAMES[:3], find_our_unit("base_force", None))
    units |= dict.fromkeys(WRENCH_NAMES[3:], find_our_unit("base_moment", None))
    joint_kinds = kinds or (_TURNS,) * len(joints)
    for kind in STORED_KINDS:
        names = name_stored_columns(kind, joints)
        units |= {name: find_our_unit(kind, joint) for name, joint in zip(names, joint_kinds, strict=True)}
    return {name: units[name] for name in columns if name in units}


def _read_columns(recording: Recording) -> dict[str, NDArray[np.generic]]:
    parts = [
        rows
        for segment in recording.segments
        for rows in recording.source.rows(segment.first_row, segment.length, segment.length)
    ]
    # Rows in memory carry no times: these follow from the segments.
    every = [(segment, np.arange(segment.length)) for segment in recording.segments]
    columns: dict[str, NDArray[np.generic]] = {
        "t": np.concatenate([segment.start_time + k * recording.period for segment, k in every]),
        "segment": np.concatenate([np.full(len(k), segment.label, dtype=np.int64) for segment, k in every]),
    }
    signals: tuple[tuple[str, list[FloatArray | None]], ...] = (
        ("q", [rows.q for rows in parts]),
        ("q_command", [rows.command for rows in parts]),
        ("tau", [rows.tau for rows in parts]),
        ("wrench", [rows.wrench for rows in parts]),
        ("temperature", [rows.temperature for rows in parts]),
    )
    for kind, blocks in signals:
        measured = [values for values in blocks if values is not None]
        # A signal that some blocks lack is left out: its column would be shorter than the others.
        if len(measured) == len(blocks):
            whole = np.concatenate(measured)
            columns |= {name: whole[:, k] for k, name in enumerate(name_stored_columns(kind, recording.joint_names))}
    return columns


@dataclass(frozen=True, eq=False)
class _CommandedSource:
    """Rows of another source with the commanded positions."""

    source: SampleSource

    def rows(self, first: int, length: int, block_length: int) -> Iterator[StoredRows]:
        for rows in self.source.rows(first, length, block_length):
            assert rows.command is not None
            yield rows._replace(q=rows.command)


def replace_by_command(recording: Recording) -> Recording:
    """Return the recording as it was commanded: with the positions that the robot was told to take.

    Parameters
    ----------
    recording : Recording
        The checked recording.

    Returns
    -------
    Recording
        The same rows, with the commanded positions in place of the measured ones.

    Raises
    ------
    ValueError
        If it holds no commanded positions.
    """
    if not recording.has_command:
        raise ValueError(f"{recording.name} has no commanded positions")
    # Without a path: the file holds the measured positions, and may not stand for this recording.
    return replace(recording, source=_CommandedSource(recording.source), path=None)


METADATA_KEY = b"dynident.recording"
LAYOUT_VERSION = 1


@dataclass(frozen=True, eq=False)
class ArraySource:
    """Rows held in memory.

    Parameters
    ----------
    q, tau : (m, n)
        Positions in rad or m, and torques in N m or forces in N.
    temperature : (m, n), optional
        Temperatures of the joints in degC.
    wrench : (m, 6), optional
        Force in N, then moment in N m, of the base on the robot.
    command : (m, n), optional
        Positions that the robot was told to take, in rad or m.
    """

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
    """Rows of a canonical Parquet file, read row group by row group.

    Parameters
    ----------
    path : path
        Where the file lies.
    joint_names : tuple of str
        Names of the n joints, in the robot's order.
    has_temperature, has_wrench, has_command : bool
        Which of the optional signals the file holds.
    """

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
            # Row groups can be read only from their first row on: what stands before the wanted rows is passed over
            # below.
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
        "torque_from_commands": recording.torque_from_commands,
        "torque_ranges": recording.torque_ranges,
    }
    return json.dumps(content).encode()


def open_recording(path: Path | str) -> Recording:
    """Open a canonical recording that `import_recording` has stored.

    Parameters
    ----------
    path : path
        Where the file lies.

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
        raise RecordingError(f"{path.name} is not a Parquet file: {error}") from error
    if described is None:
        raise RecordingError(f"{path.name} is not a stored recording; import it first.")
    content = json.loads(described)
    if content["layout_version"] != LAYOUT_VERSION:
        raise RecordingError(
            f"{path.name} has layout {content['layout_version']}, not {LAYOUT_VERSION}; import the recording again."
        )
    joint_names = tuple(content["joint_names"])
    # Entries that were added later have a default: files that were stored before lack them.
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
        torque_from_commands=content.get("torque_from_commands", False),
        torque_ranges=tuple((low, high) for low, high in content.get("torque_ranges", ())),
    )
