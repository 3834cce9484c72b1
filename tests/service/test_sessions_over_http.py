"""Simulations of several runs: a payload in some of them, joints that warm up, one measurement of it all."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import wait_for

from dynident.robot import library_table


@pytest.fixture(scope="module")
def robot(client: TestClient) -> str:
    body = {"name": "scara", "description": {"format": "modified_dh", "content": library_table("scara")}}
    return str(client.post("/v1/robots", json=body).json()["id"])


def body_of(robot: str, **more: Any) -> dict[str, Any]:
    drives = [{"effect": name} for name in ("rotor_inertia", "coulomb", "viscous")]
    payload = {"effect": "payload", "runs": ["2"]}
    motion = {"duration": 3.0, "sampling_rate": 100.0}
    return {"robot_id": robot, "trajectory": motion, "effects": [*drives, payload], "runs": 2, **more}


def test_runs_become_segments_of_one_measurement(client: TestClient, robot: str) -> None:
    created = client.post("/v1/simulations", json=body_of(robot, pause=200.0, warming={"start": 22.0})).json()

    def finished() -> Any:
        shown = client.get(f"/v1/simulations/{created['id']}").json()
        return shown if shown["status"] in ("succeeded", "failed") else None

    done = wait_for(finished, 60.0)
    assert done["status"] == "succeeded", done
    measurement = client.get(f"/v1/measurements/{done['result']['measurement_id']}").json()
    segments = measurement["segments"]
    assert [segment["label"] for segment in segments] == [1, 2]
    assert measurement["has_temperature"]


def test_a_run_that_is_not_made_is_refused_at_once(client: TestClient, robot: str) -> None:
    answer = client.post("/v1/simulations", json=body_of(robot, runs=1))
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/effects/3/runs"
    assert "there are the runs 1" in answer.text


@pytest.mark.parametrize(
    ("changed", "pointer"),
    [({"runs": 0}, "/runs"), ({"pause": -1}, "/pause"), ({"warming": {"time_constant": 0}}, "/warming/time_constant")],
)
def test_a_session_that_cannot_be_is_refused(
    client: TestClient, robot: str, changed: dict[str, Any], pointer: str
) -> None:
    answer = client.post("/v1/simulations", json=body_of(robot, **changed))
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == pointer
