"""Recordings of an arm as CSV files, uploaded to the service."""

from __future__ import annotations

import hashlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient

Columns = dict[str, np.ndarray]


def move_two_joints(seconds: float = 12.0, rate: float = 100.0, seed: int = 1) -> Columns:
    """A motion of two joints, and some torque that its dynamics explain in part."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    w = 2 * np.pi * np.array([0.2, 0.5, 0.9])
    phase = rng.uniform(0, 6, (2, 3))
    q = np.stack([0.35 * np.sin(np.outer(t, w) + phase[j]).sum(axis=1) for j in range(2)], axis=1)
    dq, ddq = np.gradient(q, t, axis=0), np.gradient(np.gradient(q, t, axis=0), t, axis=0)
    tau = 3.0 * ddq @ np.array([[1.0, 0.3], [0.3, 0.6]]) + 2.0 * np.sign(dq) + 1.5 * dq
    tau += 0.02 * rng.normal(size=tau.shape)
    q += 1e-5 * rng.normal(size=q.shape)
    return {"t": t, "q1": q[:, 0], "q2": q[:, 1], "tau1": tau[:, 0], "tau2": tau[:, 1]}


def sound(n_rows: int = 2000, rate: float = 200.0) -> Columns:
    """A recording of two parallel vertical axes that passes every check."""
    t = np.arange(n_rows) / rate
    columns: Columns = {"t": t}
    noise = np.random.default_rng(1)
    for joint, (frequency, inertia) in enumerate(((0.31, 8.0), (0.53, 3.0)), start=1):
        q, dq, ddq = np.zeros(n_rows), np.zeros(n_rows), np.zeros(n_rows)
        for harmonic, size in ((1, 0.6), (2, 0.3), (3, 0.12)):
            w = 2 * np.pi * frequency * harmonic
            q += size * np.sin(w * t + harmonic * joint)
            dq += size * w * np.cos(w * t + harmonic * joint)
            ddq -= size * w * w * np.sin(w * t + harmonic * joint)
        columns[f"q{joint}"] = q
        columns[f"tau{joint}"] = inertia * ddq + 4.0 * np.sign(dq) + 3.0 * dq + noise.normal(0, 0.1, n_rows)
    return columns


def as_csv(columns: Columns) -> bytes:
    text = io.StringIO()
    np.savetxt(text, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    return text.getvalue().encode()


def upload(client: TestClient, robot: dict[str, Any], content: bytes, key: str = "", **metadata: Any) -> Any:
    said = {"robot_id": robot["id"], "name": "run", "role": "identification", **metadata}
    headers = {"Idempotency-Key": key} if key else {}
    form = {"metadata": json.dumps(said)}
    return client.post("/v1/measurements", files={"file": ("run.csv", content)}, data=form, headers=headers)


def files_in(folder: Path) -> set[Path]:
    # One object is there for the readiness probe alone.
    probe = hashlib.sha256(b"dynident").hexdigest()
    return {path for path in folder.rglob("*") if path.is_file() and path.name != probe}
