"""Write comparisons, trajectories and series as CSV or Parquet; the file endings that are accepted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynident.diagnosis import Comparison
from dynident.diagnosis.monitoring import Series
from dynident.errors import DynidentError
from dynident.excitation import Design, design_table
from dynident.excitation.design_files import format_joint_trajectory
from dynident.recordings.arrow_tables import table_from_arrays, to_csv
from dynident.recordings.joint_phases import Phase
from dynident.text_encoding import encode_text, escape_surrogates
from dynident_cli.input_checks_and_writes import write_atomically

ENDINGS = (".csv", ".parquet")
TRAJECTORY_ENDINGS = (*ENDINGS, ".yaml")
_SIGNALS = ("measured", "predicted", "lower", "upper", "residual", "band", "q", "dq")
_PHASES = np.array([phase.name.lower() for phase in Phase])


def check_ending(path: Path, endings: tuple[str, ...] = ENDINGS) -> None:
    """Check that a result can be written, before the computation begins.

    Raises
    ------
    DynidentError
        Where the ending is not one of `endings`, or the folder is missing.
    """
    if path.suffix not in endings:
        allowed = f"{', '.join(endings[:-1])} or {endings[-1]}"
        raise DynidentError(f"cannot write {path.name}; the ending of the name must be {allowed}", pointer="--out")
    if not path.parent.is_dir():
        raise DynidentError(f"there is no folder {path.parent}", pointer="--out", title="No such folder")


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table as CSV or Parquet, by the ending of the file."""
    check_ending(path)
    if path.suffix == ".parquet":
        # In memory first: the file is to appear complete, or not at all.
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink)
        write_atomically(path, sink.getvalue().to_pybytes())
    else:
        write_atomically(path, to_csv(table))


def write_trajectory(design: Design, path: Path) -> None:
    """Write a trajectory.

    Parameters
    ----------
    design : Design
        The design with its trajectory.
    path : Path
        .csv or .parquet: a table of t, q_<joint>…, dq_<joint>…, ddq_<joint>…; .yaml: a message for ROS 2.
    """
    if path.suffix == ".yaml":
        lines = format_joint_trajectory(design.joint_names, design.t, design.q, design.dq, design.ddq)
        write_atomically(path, encode_text("".join(lines)))
    else:
        write_table(design_table(design), path)


def build_comparison_table(comparison: Comparison) -> pa.Table:
    """Build the table of a comparison.

    Its columns are t, segment, and for every joint measured_, predicted_, lower_, upper_, residual_, band_, q_, dq_,
    phase_. The phase is moving, reversing, standing, or passive_halt where a passive joint reverses or stands.
    Where a joint stands, lower and upper are the limits of what static friction may hold.
    """
    columns: dict[str, Any] = {"t": comparison.t, "segment": comparison.segment.astype(np.int64)}
    for signal in _SIGNALS:
        values = getattr(comparison, signal)
        for index, joint in enumerate(comparison.joint_names):
            # Arrow takes columns that are contiguous.
            columns[f"{signal}_{joint}"] = np.ascontiguousarray(values[:, index])
    for index, joint in enumerate(comparison.joint_names):
        columns[f"phase_{joint}"] = _PHASES[comparison.phase[:, index]]
    return table_from_arrays(columns)


def build_courses_table(series: Series) -> pa.Table:
    """Build a table with one row a parameter and day: parameter, effect, joint, unit, day, value, 95 % interval."""
    rows = [
        {
            "parameter": escape_surrogates(course.parameter),
            "effect": course.effect,
            "joint": escape_surrogates(course.joint),
            "unit": course.unit,
            "day": escape_surrogates(day),
            "value": float(course.values[k]),
            "lower": float(course.intervals[k, 0]),
            "upper": float(course.intervals[k, 1]),
        }
        for course in series.courses
        for k, day in enumerate(series.days)
    ]
    return pa.Table.from_pylist(rows)
