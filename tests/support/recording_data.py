"""Made recordings that the tests of this room share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

JOINTS = ("shoulder", "elbow", "wrist")
GAINS = (50.0, 40.0, 20.0)


def motion(n_rows: int = 3000, rate: float = 200.0, seed: int = 3) -> dict[str, np.ndarray]:
    """A smooth three-joint motion and torques that obey a plausible law: columns t, q1…, tau1…."""
    rng = np.random.default_rng(seed)
    t = np.arange(n_rows) / rate
    columns: dict[str, np.ndarray] = {"t": t}
    q, dq, ddq = np.zeros((n_rows, 3)), np.zeros((n_rows, 3)), np.zeros((n_rows, 3))
    for harmonic in range(1, 6):
        w = 2 * np.pi * 0.13 * harmonic
        a, phase = rng.uniform(0.1, 0.5, 3) / harmonic, rng.uniform(0, 2 * np.pi, 3)
        angle = w * t[:, None] + phase
        q += a * np.sin(angle)
        dq += a * w * np.cos(angle)
        ddq -= a * w * w * np.sin(angle)
    inertia, gravity = np.array([12.0, 6.0, 1.5]), np.array([0.0, 60.0, 12.0])
    coulomb, viscous = np.array([8.0, 6.0, 2.0]), np.array([6.0, 5.0, 1.0])
    level = np.cumsum(q, axis=1)
    tau = inertia * ddq + gravity * np.cos(level) + coulomb * np.sign(dq) + viscous * dq
    tau += rng.normal(0, 0.2, tau.shape)
    for joint in range(3):
        columns[f"q{joint + 1}"] = q[:, joint]
        columns[f"tau{joint + 1}"] = tau[:, joint]
    columns["dq_true"] = dq  # (n, 3): for tests that compare, not a column
    return columns


def write_parquet(path: Path, columns: dict[str, np.ndarray]) -> Path:
    flat = {name: values for name, values in columns.items() if np.ndim(values) == 1}
    pq.write_table(pa.table(flat), path)
    return path


def write_csv(path: Path, columns: dict[str, np.ndarray], separator: str = ",", comma: bool = False) -> Path:
    flat = {name: values for name, values in columns.items() if np.ndim(values) == 1}
    lines = [separator.join(flat)]
    for row in zip(*flat.values(), strict=True):
        text = separator.join(repr(float(value)) for value in row)
        lines.append(text.replace(".", ",") if comma else text)
    path.write_text("\n".join(lines) + "\n")
    return path
