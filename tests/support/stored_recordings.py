"""Robots and recordings that are stored in a service for its page."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

from support.two_link_arm import URDF

FOREIGN = ("stamp", "axis 2 moment", "axis 1 pos", "axis 2 pos", "axis 1 moment")
OURS = ("t", "tau_elbow", "q_shoulder", "q_elbow", "tau_shoulder")


def robot_of(page: Any) -> str:
    body = {"name": "two links", "description": {"format": "urdf", "content": URDF}}
    return str(page.request.post("/v1/robots", data=body).json()["id"])


def stored(page: Any, robot: str, path: Path, **said: Any) -> str:
    """A measurement that is uploaded without the page."""
    sent = {
        "file": {"name": path.name, "mimeType": "text/csv", "buffer": path.read_bytes()},
        "metadata": json.dumps({"robot_id": robot, "name": path.stem, **said}),
    }
    answer = page.request.post("/v1/measurements", multipart=sent)
    assert answer.status == 201, answer.text()
    return str(answer.json()["id"])


def foreign(source: Path, path: Path) -> Path:
    """The same recording as another logger writes it: other names, another order, degrees."""
    with source.open() as opened, path.open("w", newline="") as written:
        writer = csv.writer(written)
        writer.writerow(FOREIGN)
        for line in csv.DictReader(opened):
            values = [float(line[name]) for name in OURS]
            writer.writerow(
                [math.degrees(value) if "pos" in name else value for name, value in zip(FOREIGN, values, strict=True)]
            )
    return path
