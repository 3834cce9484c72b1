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
