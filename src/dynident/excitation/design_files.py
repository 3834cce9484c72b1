"""Write a designed trajectory as CSV, Parquet, JSON or ROS 2 JointTrajectory (YAML)."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from dynident.array_types import FloatArray, IntArray
from dynident.errors import DynidentError
from dynident.excitation.criteria.optimality_criteria import CriterionValues
from dynident.excitation.design_request import LEAST_SPEED
from dynident.excitation.design_result import Design
from dynident.file_output import write_atomically
from dynident.recordings.arrow_tables import (
    table_column_to_floats,
    table_column_to_numbers,
    table_from_arrays,
    to_header_row,
    write_table,
)
from dynident.text_encoding import encode_text

_NANOSECONDS = 1_000_000_000


def format_joint_trajectory(
    joint_names: Sequence[str], t: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> Iterator[str]:
    """Yield the lines of the message.

    The header's stamp is zero: the controller begins as soon as it has the message.

    Parameters
    ----------
    joint_names : sequence of str
        Names as the controller knows them.
    t : (m,)
        Times from the start, s.
    q, dq, ddq : (m, n)
        Positions, velocities and accelerations: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).
    """
    yield "header:\n  stamp: {sec: 0, nanosec: 0}\n  frame_id: ''\n"
    yield f"joint_names: [{', '.join(json.dumps(name) for name in joint_names)}]\n"
    yield "points:\n"
    # Whole nanoseconds before seconds are split off: rounding the remainder alone could give a full second.
    stamps = np.rint((t - t[0]) * _NANOSECONDS).astype(np.int64)
    for stamp, position, velocity, acceleration in zip(stamps, q, dq, ddq, strict=True):
        seconds, rest = divmod(int(stamp), _NANOSECONDS)
        yield (
            f"- positions: {_format_list(position)}\n"
            f"  velocities: {_format_list(velocity)}\n"
            f"  accelerations: {_format_list(acceleration)}\n"
            f"  time_from_start: {{sec: {seconds}, nanosec: {rest}}}\n"
        )


def _format_list(values: Iterable[float]) -> str:
    # YAML takes 1e-05 for a word: a number with an exponent needs a decimal point.
    return "[" + ", ".join(_format_number(float(value)) for value in values) + "]"


def _format_number(value: float) -> str:
    text = f"{value:.12g}"
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return text if any(mark in text for mark in ".e") else f"{text}.0"


FORMATS = ("csv", "parquet", "json")
"""Formats of a trajectory."""


def design_table(design: Design) -> pa.Table:
    """Return the samples of a design as a table.

    Parameters
    ----------
    design : Design
        The verified design.

    Returns
    -------
    pyarrow.Table
        Columns t, q_<joint>…, dq_<joint>…, ddq_<joint>…. For a set of test motions also `segment`: the number of the
        run from 1 on, 0 on the moves between runs. A recording that keeps it is cut there.
    """
    columns: dict[str, FloatArray | IntArray] = {"t": design.t}
    if design.runs:
        columns["segment"] = design.segments
    for prefix, values in (("q", design.q), ("dq", design.dq), ("ddq", design.ddq)):
        columns |= {f"{prefix}_{name}": values[:, j] for j, name in enumerate(design.joint_names)}
    return table_from_arrays(columns)


def slow_down(table: pa.Table, speed: float) -> pa.Table:
    """Return the rows of a trajectory for the same path at a share of its speed.

    Parameters
    ----------
    table : pyarrow.Table
        The trajectory, as `design_table` gives it, or some of its rows.
    speed : float
        The share of the speed. The rows stay the same, so that the sampling rate falls by this share.

    Returns
    -------
    pyarrow.Table
        Times divided by the share, velocities times the share, accelerations times its square.
    """
    powers = {"t": -1, "dq": 1, "ddq": 2}
    for index, name in enumerate(table.column_names):
        power = powers.get(name.partition("_")[0])
        if power is not None and speed != 1.0:
            table = table.set_column(index, name, pc.multiply(table.column(index), speed**power))
    return table


def write_design(design: Design, path: Path, speed: float = 1.0) -> None:
    """Write the trajectory to a file: t in s, positions in rad or m and their derivatives, row by row.

    Parameters
    ----------
    design : Design
        The verified design.
    path : Path
        The file: .csv, .parquet, or .yaml for a JointTrajectory of ROS 2.
    speed : float
        Share of the designed speed, for a first run on the robot: `LEAST_SPEED` to 1.

    Raises
    ------
    DynidentError
        For a file of another ending, or a speed that is no such share.
    """
    if not LEAST_SPEED <= speed <= 1.0:
        raise DynidentError(f"{speed:g} is not a share of the speed; give {LEAST_SPEED:g} to 1", pointer="speed")
    table = slow_down(design_table(design), speed)
    if path.suffix == ".yaml":
        t, names = table_column_to_floats(table.column("t")), design.joint_names
        # The last columns are the signals: positions, velocities, accelerations, joint by joint.
        signals = [table_column_to_floats(column) for column in table.columns[-3 * len(names) :]]
        q, dq, ddq = np.split(np.column_stack(signals), 3, axis=1)
        write_atomically(path, encode_text("".join(format_joint_trajectory(names, t, q, dq, ddq))))
    elif path.suffix == ".parquet":
        write_table(table, path)
    elif path.suffix == ".csv":
        stream = BytesIO(to_header_row(table.column_names))
        stream.seek(0, os.SEEK_END)
        values = np.column_stack([table_column_to_numbers(column) for column in table.columns])
        # Times are decimal fractions; twelve digits keep positions far below any encoder's step.
        np.savetxt(stream, values, fmt="%.12g", delimiter=",")
        write_atomically(path, stream.getvalue())
    else:
        raise DynidentError(f"cannot write a trajectory to {path.name}; use .csv, .parquet or .yaml", pointer="format")


def trajectory_document(design: Design) -> dict[str, object]:
    """Return the trajectory as JSON: t, and q, dq, ddq as [sample][joint].

    Parameters
    ----------
    design : Design
        The verified design.

    Returns
    -------
    dict
        Lists and numbers only, as JSON has them.
    """
    return {
        "joints": list(design.joint_names),
        "sampling_rate": design.sampling_rate,
        "t": design.t.tolist(),
        "q": design.q.tolist(),
        "dq": design.dq.tolist(),
        "ddq": design.ddq.tolist(),
    }


def design_document(design: Design) -> dict[str, object]:
    """Return what a design achieves, as JSON.

    Parameters
    ----------
    design : Design
        The verified design.

    Returns
    -------
    dict
        Infinite numbers (W without full rank) are None.
    """
    baseline = design.baseline
    return {
        "criterion_values": _to_dict(design.criterion_values),
        "baseline_values": None
        if baseline is None
        else {
            **_to_dict(baseline.best),
            "median_condition_number": _finite_or_none(baseline.median_condition_number),
            "median_scaled_condition_number": _finite_or_none(baseline.median_scaled_condition_number),
            "count": baseline.count,
        },
        "margins": [asdict(margin) for margin in design.margins],
        "n_samples": design.n_samples,
        "duration": design.duration,
        "sampling_rate": design.sampling_rate,
        "exciting": {"from": design.exciting[0], "to": design.exciting[1], "period": design.period},
        "parameters": list(design.parameter_names),
        "expected_parameters": [
            {
                **asdict(parameter),
                "standard_deviation": None
                if parameter.standard_deviation is None
                else _finite_or_none(parameter.standard_deviation),
            }
            for parameter in design.expected
        ],
        "runs": [asdict(run) for run in design.runs],
        "notes": list(design.notes),
    }


def _to_dict(values: CriterionValues) -> dict[str, object]:
    return {name: _finite_or_none(value) for name, value in asdict(values).items()}


def _finite_or_none(value: float) -> float | None:
    # JSON has no infinity.
    return value if math.isfinite(value) else None
