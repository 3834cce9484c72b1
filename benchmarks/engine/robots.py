"""Arms by name: those of the library, and arms that nobody built, drawn from a number."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from dynident.robot import Robot, robot_from_library, robot_from_modified_dh
from engine.closed_loop import typical_torque
from engine.scene import FloatArray

_TWISTS = (0.0, -np.pi / 2, 0.0, -np.pi / 2, np.pi / 2, -np.pi / 2)
_MASSES = (8.0, 7.0, 4.0, 2.5, 1.8, 0.8)


@cache
def arm_by_name(name: str) -> Robot:
    """An arm of the library; `six-<number>` or `three-<number>`: so many revolute joints; `sliding-<number>`."""
    kind, _, number = name.partition("-")
    if kind in ("six", "three", "sliding") and number.isdigit():
        return _drawn(name, int(number), sliding=kind == "sliding", joints=3 if kind == "three" else 6)
    return robot_from_library(name)


def as_described(robot: Robot, seed: int, spread: float = 0.15) -> Robot:
    """The robot as its maker describes it: masses and centres of the links are some 15 % off the truth."""
    assert robot.inertias is not None
    rng = np.random.default_rng([seed, 77])
    inertias = robot.inertias * np.clip(rng.normal(1.0, spread, (robot.n, 1)), 0.6, 1.5)
    for row in inertias:
        _move_centre(row, rng.normal(0.0, spread, 3) * row[6:9] / row[9])
    return replace(robot, inertias=inertias)


def _move_centre(row: FloatArray, by: FloatArray) -> None:
    """Move the link's matter, keeping its inertia about its centre."""
    mass, old = row[9], row[6:9] / row[9]
    new = old + by
    for sign, c in ((-1.0, old), (1.0, new)):
        steiner = mass * (c @ c * np.eye(3) - np.outer(c, c))
        row[:6] += sign * steiner[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    row[6:9] = mass * new


def _drawn(name: str, number: int, *, sliding: bool, joints: int) -> Robot:
    rng = np.random.default_rng([number, sliding])
    rows = [_row(j, rng, slides=sliding and j == 2) for j in range(joints)]
    first = robot_from_modified_dh(name, json.dumps(rows))
    # Motors are chosen for what the arm asks of them.
    torque = typical_torque(first, seed=number)
    for row, needed in zip(rows, torque, strict=True):
        row["limits"]["effort"] = float(np.ceil(2.0 * needed + 4.0))
    return robot_from_modified_dh(name, json.dumps(rows))


def _row(j: int, rng: np.random.Generator, *, slides: bool) -> dict[str, Any]:
    lengths: dict[int, dict[str, float]] = {
        0: {"r": rng.uniform(0.2, 0.5)},
        1: {"d": rng.uniform(0.0, 0.25), "r": rng.uniform(-0.1, 0.1)},
        2: {"d": rng.uniform(0.3, 0.6), "r": rng.uniform(-0.1, 0.1)},
        3: {"d": rng.uniform(-0.1, 0.1), "r": rng.uniform(0.25, 0.5)},
        4: {"r": rng.uniform(0.0, 0.1)},
        5: {"d": rng.uniform(0.0, 0.08), "r": rng.uniform(0.05, 0.12)},
    }
    mass = float(_MASSES[j] * rng.uniform(0.7, 1.3))
    size = 0.22 if j < 4 else 0.07
    centre = rng.uniform(-0.6, 0.6, 3) * size
    edges = rng.uniform(0.3, 1.2, 3) * size
    inertia = mass / 12 * (np.sum(edges**2) - edges**2)
    limits: dict[str, Any] = (
        {"position": [0.1, 0.7], "velocity": 0.8, "acceleration": 4.0}
        if slides
        else {
            "position": [-float(rng.uniform(2.0, 3.1)), float(rng.uniform(2.0, 3.1))],
            "velocity": float(rng.uniform(1.8, 3.5)),
            "acceleration": float(rng.uniform(6.0, 15.0)),
        }
    )
    return {
        "name": f"axis_{j + 1}",
        "sigma": int(slides),
        "alpha": _TWISTS[j] + (-np.pi / 2 if slides else 0.0),
        **lengths[j],
        "limits": limits,
        "mass_properties": {
            "mass": mass,
            "center_of_mass": [float(c) for c in centre],
            "inertia": [float(inertia[0]), 0.0, 0.0, float(inertia[1]), 0.0, float(inertia[2])],
        },
    }
