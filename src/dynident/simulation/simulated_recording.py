"""Recordings of a virtual robot with the true parameters, and their Parquet files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import table_from_arrays, to_csv
from dynident.robot.robot_model import Robot


@dataclass(frozen=True, eq=False)
class Truth:
    """What really happened at the samples, without quantisation and noise.

    Parameters
    ----------
    q : (m, n)
        Positions, rad or m.
    dq : (m, n)
        Velocities, rad/s or m/s.
    ddq : (m, n)
        Accelerations, rad/s² or m/s².
    tau : (m, n)
        Torque that the motors gave, N m or N; wrong gains or a delay enter only where it is measured.
    """

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    tau: FloatArray


@dataclass(frozen=True, eq=False)
class SimulatedRecording:
    """A virtual robot's recording.

    Parameters
    ----------
    robot : Robot
        The robot that was measured.
    t : (m,)
        Times, s.
    q : (m, n)
        Positions as the encoders give them, rad or m.
    tau : (m, n)
        Measured motor torque, N m or N, referred to the joint, with noise.
    current : (m, n) or None
        Motor currents, A, which replace `tau` in the file where the robot records currents.
    temperature : (m, n) or None
        Joint temperatures, degC.
    truth : Truth
        The motion and torque without sensors.
    noise : (n,)
        Standard deviation of the torque noise, N m or N: no model can predict better than this.
    tracking_error : (n,)
        Largest distance of each joint from the reference, rad or m.
    segment : (m,) or None
        Number of the run, from 1 on, where there is more than one.
    """

    robot: Robot
    t: FloatArray
    q: FloatArray
    tau: FloatArray
    current: FloatArray | None
    temperature: FloatArray | None
    truth: Truth
    noise: FloatArray
    tracking_error: FloatArray
    segment: NDArray[np.int64] | None = None

    @property
    def n_samples(self) -> int:
        """Number of samples m."""
        return len(self.t)


def join_runs(runs: Sequence[SimulatedRecording]) -> SimulatedRecording:
    """Concatenate runs of one robot into one recording with a segment for each.

    Parameters
    ----------
    runs : sequence of SimulatedRecording
        Runs in the order of time, all with the same sensors.

    Returns
    -------
    SimulatedRecording
        One recording with a segment for each run; a single run is returned as it is.
    """
    if len(runs) == 1:
        return runs[0]
    first = runs[0]
    return replace(
        first,
        t=np.concatenate([run.t for run in runs]),
        q=np.concatenate([run.q for run in runs]),
        tau=np.concatenate([run.tau for run in runs]),
        current=_stack_parts([run.current for run in runs]),
        temperature=_stack_parts([run.temperature for run in runs]),
        truth=Truth(
            *(np.concatenate(series) for series in zip(*(_split_truth(run.truth) for run in runs), strict=True))
        ),
        # One number a joint has to stand for all runs; the largest promises too much of none of them.
        noise=np.max([run.noise for run in runs], axis=0),
        tracking_error=np.max([run.tracking_error for run in runs], axis=0),
        segment=np.repeat(np.arange(1, len(runs) + 1), [run.n_samples for run in runs]),
    )


def _split_truth(truth: Truth) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    return truth.q, truth.dq, truth.ddq, truth.tau


def _stack_parts(parts: Sequence[FloatArray | None]) -> FloatArray | None:
    present = [part for part in parts if part is not None]
    return np.concatenate(present) if present else None


def build_recording_table(measurement: SimulatedRecording) -> pa.Table:
    """Return the columns of a recording's file.

    Parameters
    ----------
    measurement : SimulatedRecording
        The recording to be written.

    Returns
    -------
    pyarrow.Table
        Columns t, q1 …, tau1 … or current1 …; temperature1 … and segment where there are any.
    """
    columns: dict[str, FloatArray | NDArray[np.int64]] = {"t": measurement.t}
    signals = {
        "q": measurement.q,
        **({"tau": measurement.tau} if measurement.current is None else {"current": measurement.current}),
        **({} if measurement.temperature is None else {"temperature": measurement.temperature}),
    }
    for name, values in signals.items():
        columns |= {f"{name}{j + 1}": values[:, j] for j in range(values.shape[1])}
    if measurement.segment is not None:
        columns["segment"] = measurement.segment
    return table_from_arrays(columns)


def write_simulated_recording(
    measurement: SimulatedRecording, path: Path, file_format: Literal["csv", "parquet"] = "parquet"
) -> Path:
    """Write a file that `dynident.recordings.import_recording` reads.

    Parameters
    ----------
    measurement : SimulatedRecording
        The recording to be written.
    path : Path
        The file, which is replaced if it exists.
    file_format : {"parquet", "csv"}
        Format of the file.

    Returns
    -------
    Path
        The path that was given.
    """
    table = build_recording_table(measurement)
    if file_format == "csv":
        path.write_bytes(to_csv(table))
    else:
        pq.write_table(table, path)
    return path
