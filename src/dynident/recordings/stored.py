"""All samples of a stored recording at once, as columns, with their units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynident.arrays import FloatArray
from dynident.recordings.arrow import table_column_to_numbers
from dynident.recordings.sources import ParquetSource, name_stored_columns
from dynident.recordings.types import WRENCH_NAMES, JointKind, Recording
from dynident.recordings.units import STORED_KINDS, find_our_unit

_TURNS: JointKind = "revolute"


@dataclass(frozen=True, eq=False)
class StoredSamples:
    """Samples by column, each (m,), and the unit of each that has one."""

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
    kinds : "revolute" or "prismatic", one a joint
        Empty: they are not known, and joints count as revolute.

    Returns
    -------
    StoredSamples
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
    kinds : "revolute" or "prismatic", one a joint
        Empty: joints count as revolute.

    Returns
    -------
    dict
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
        if len(measured) == len(blocks):
            whole = np.concatenate(measured)
            columns |= {name: whole[:, k] for k, name in enumerate(name_stored_columns(kind, recording.joint_names))}
    return columns
