"""A motion in which joints are told to rest can be simulated: that they rest is no finding against it."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import wait_for

from dynident.robot import library_table

TRAJECTORY = {"duration": 3.0, "harmonics": 3, "sampling_rate": 50.0, "joints": ["elbow", "tool_roll"]}


def ended(client: TestClient, made: dict[str, Any], kind: str) -> dict[str, Any]:
    def done() -> dict[str, Any] | None:
        job = client.get(f"/v1/jobs/{made['job_id']}").json()
        return job if job["state"] in ("succeeded", "failed", "cancelled") else None

    job = wait_for(done, timeout=120)
    assert job["state"] == "succeeded", job
    shown: dict[str, Any] = client.get(f"/v1/{kind}/{made['id']}").json()
    return shown


@pytest.mark.slow
@pytest.mark.parametrize("by_design", [True, False])
def test_a_design_of_some_joints_is_simulated(client: TestClient, by_design: bool) -> None:
    body = {"name": "scara", "description": {"format": "modified_dh", "content": library_table("scara")}}
    robot = client.post("/v1/robots", json=body).json()["id"]
    motion: dict[str, Any] = {"trajectory": TRAJECTORY}
    if by_design:
        wish = {"robot_id": robot, "kind": "random", "trajectory": TRAJECTORY}
        design = ended(client, client.post("/v1/designs", json=wish).json(), "designs")
        # Nothing around the robot was stated.
        warnings = design["result"]["warnings"]
        assert warnings
        assert set(warnings) < set(design["result"]["notes"])
        assert design["result"]["warning_codes"] == ["floor_alone_checked"]
        told = design["result"]["remedies"]
        assert [(one["field"], one["value"]) for one in told] == [("identification_id", None), ("assume_floor", False)]
        assert all(any(one["text"] in note for note in design["result"]["notes"]) for one in told)
        motion = {"design_id": design["id"]}
    made = client.post("/v1/simulations", json={"robot_id": robot, **motion}).json()
    found = ended(client, made, "simulations")
    measurement = client.get(f"/v1/measurements/{found['result']['measurement_id']}").json()
    told = {check["name"]: check for check in measurement["checks"]}
    assert told["joint_motion"]["status"] == "warning"
    assert "shoulder" in told["joint_motion"]["detail"]
