"""What a virtual robot's measurement gives, and how it is written down."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from dynident.robot.model import FloatArray, Robot


@dataclass(frozen=True, eq=False)
class Truth:
    """What really happened at the samples: q, dq, ddq, tau (m, n), without quantisation and noise."""

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    tau: FloatArray


@dataclass(frozen=True, eq=False)
class Measurement:
    """A virtual robot's recording.

    t (m,) in s; q (m, n) as the encoders give it; `tau` (m, n) measured motor torque in N m or N, referred to the
    joint, with noise; `current` (m, n) instead of it in the file where the robot records currents; `truth` behind
    them; `noise` (n,) standard deviation of the torque noise: no model can predict better than this;
    `tracking_error` (n,) largest distance from the reference.
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

    @property
    def n_samples(self) -> int:
        """Number of samples m."""
        return len(self.t)


def measurement_table(measurement: Measurement) -> pa.Table:
    """The columns of a measurement file: t, q1 …, tau1 … or current1 …, temperature1 … where there is any."""
    columns: dict[str, FloatArray] = {"t": measurement.t}
    signals = {
        "q": measurement.q,
        **({"tau": measurement.tau} if measurement.current is None else {"current": measurement.current}),
        **({} if measurement.temperature is None else {"temperature": measurement.temperature}),
    }
    for name, values in signals.items():
        columns |= {f"{name}{j + 1}": np.ascontiguousarray(values[:, j]) for j in range(values.shape[1])}
    return pa.table(columns)


def write_measurement(measurement: Measurement, path: Path, file_format: Literal["csv", "parquet"] = "parquet") -> Path:
    """Write a measurement as a file that `dynident.recordings.import_recording` reads."""
    table = measurement_table(measurement)
    if file_format == "csv":
        pacsv.write_csv(table, path)
    else:
        pq.write_table(table, path)
    return path
