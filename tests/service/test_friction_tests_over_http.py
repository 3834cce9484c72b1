"""Measurements of single joints, with the role friction, beside those of the whole robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynident.robot import library_table, robot_from_library
from dynident.simulation import Reference, Sensors, SimulationRequest, TrueEffect, simulate, write_simulated_recording
from dynident_client import Client

pytestmark = pytest.mark.slow

ROBOT = robot_from_library("scara")
RATE = 200.0
FRICTION = {"Fc": (4.0, 3.0, 2.0, 1.0), "Fv": (3.0, 2.5, 2.0, 0.5)}
IDS = {"Fc": "coulomb", "Fv": "viscous"}
EFFECTS = tuple(
    TrueEffect(IDS[kind], name, ((kind, value),))
    for kind, values in FRICTION.items()
    for name, value in zip(ROBOT.joint_names, values, strict=True)
)


def sweep(joint: int) -> Reference:
    """One joint at three speeds in both directions, ramps of a quarter of a second between them."""
    limit = (ROBOT.joints[joint].limits.velocity or 1.0) * 0.15
    scale = min(limit, 0.3 if ROBOT.joints[joint].kind == "revolute" else 0.03)
    ramp = round(0.25 * RATE)
    dq = [np.zeros(ramp)]
    before = 0.0
    for now in (scale, 2 * scale, 3 * scale, 0.0, -3 * scale, -2 * scale, -scale, 0.0):
        dq.append(before + (now - before) * 0.5 * (1 - np.cos(np.pi * np.arange(ramp) / ramp)))
        dq.append(np.full(round((0.8 if now else 0.1) * RATE), now))
        before = now
    velocity = np.concatenate(dq)
    q, dqs, ddqs = (np.zeros((len(velocity), ROBOT.n)) for _ in range(3))
    for k, one in enumerate(ROBOT.joints):
        low, high = one.limits.position or (-1.0, 1.0)
        q[:, k] = 0.5 * (low + high) if k != joint else low + 0.3 * (high - low)
    q[:, joint] += np.cumsum(velocity) / RATE
    dqs[:, joint], ddqs[:, joint] = velocity, np.gradient(velocity) * RATE
    return Reference(np.arange(len(velocity)) / RATE, q, dqs, ddqs)


def test_friction_tests_are_sent_beside_a_motion_and_used_by_separate_friction_alone(live: Client, tmp_path: Path):
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    motion = {"duration": 10.0, "periods": 1, "sampling_rate": RATE}
    simulation = live.simulations.create(
        robot,
        effects=[
            {"effect": IDS[kind], "joints": [name], "parameters": {kind: value}}
            for kind, values in FRICTION.items()
            for name, value in zip(ROBOT.joint_names, values, strict=True)
        ],
        trajectory=motion,
        seed=3,
    )
    simulation.wait()
    whole = live.measurements.get(simulation.result["measurement_id"])
    tests = []
    for joint in range(ROBOT.n):
        made = simulate(
            ROBOT, SimulationRequest(sweep(joint), EFFECTS, sensors=Sensors(sampling_rate=RATE), seed=joint)
        )
        path = write_simulated_recording(made, tmp_path / f"joint{joint + 1}.parquet")
        tests.append(live.measurements.upload(robot, path, name=path.stem, role="friction"))
    assert all(check["status"] != "error" for run in tests for check in run.checks)
    effects = [{"effect": name} for name in ("rigid_body", "coulomb", "viscous")]
    found = live.identifications.create(robot, [whole, *tests], effects=effects, strategy="separate_friction").wait()
    values = {p["name"]: p for p in found.result["parameters"]}
    assert not any("moving alone" in warning for warning in found.result["warnings"])
    for kind, true in FRICTION.items():
        for j, value in enumerate(true):
            assert values[f"{kind}{j + 1}"]["value"] == pytest.approx(value, rel=0.1, abs=0.15)
    plain = live.identifications.create(robot, [whole], effects=effects).wait()
    beside = live.identifications.create(robot, [whole, *tests], effects=effects).wait()
    assert any("Not used: joint1" in warning for warning in beside.result["warnings"])
    assert beside.result["residual"] == plain.result["residual"]
