"""A file with the six columns of the base's wrench, uploaded and identified from."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from fastapi.testclient import TestClient
from service_helpers import wait_for
from support.oracles import arm, fourier_motion

from dynident.recordings.recording import WRENCH_NAMES
from dynident.robot import library_table, to_pinocchio

ROBOT = arm("scara")


def recording(with_wrench: bool = True) -> bytes:
    """20 s of a moving arm, its torque and the wrench that holds it, in kN and N m."""
    motion = fourier_motion(ROBOT, 20.0, 100.0, 1, base_frequency=0.1)
    model = to_pinocchio(ROBOT)
    data = model.createData()
    drawn = np.random.default_rng(0)
    rows = []
    for t, *state in zip(motion.t, motion.q, motion.dq, motion.ddq, strict=True):
        tau = pin.rnea(model, data, *state)
        wrench = data.liMi[1].act(data.f[1]).vector + drawn.normal(0, [0.5, 0.5, 0.5, 0.1, 0.1, 0.1])
        wrench[:3] *= 1e-3
        rows.append([t, *state[0], *(tau + 0.5 * np.sign(state[1])), *(wrench if with_wrench else ())])
    numbers = range(1, ROBOT.n + 1)
    names = ["t", *(f"q{k}" for k in numbers), *(f"tau{k}" for k in numbers), *(WRENCH_NAMES if with_wrench else ())]
    text = io.StringIO()
    np.savetxt(text, np.array(rows), delimiter=",", header=",".join(names), comments="")
    return text.getvalue().encode()


@pytest.fixture(scope="module")
def robot(client: TestClient) -> str:
    body = {"name": "scara", "description": {"format": "modified_dh", "content": library_table("scara")}}
    return str(client.post("/v1/robots", json=body).json()["id"])


def upload(client: TestClient, robot: str, content: bytes, **more: Any) -> dict[str, Any]:
    said = {"robot_id": robot, "name": "run", **more}
    form = {"metadata": json.dumps(said)}
    answer = client.post("/v1/measurements", files={"file": ("run.csv", content)}, data=form)
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def identified(client: TestClient, robot: str, measurement: dict[str, Any]) -> dict[str, Any]:
    body = {"robot_id": robot, "measurement_ids": [measurement["id"]], "effects": [{"effect": "rigid_body"}]}
    created = client.post("/v1/identifications", json={**body, "model": "base_wrench"}).json()

    def finished() -> Any:
        shown = client.get(f"/v1/identifications/{created['id']}").json()
        return shown if shown["status"] in ("succeeded", "failed") else None

    return dict(wait_for(finished, 60.0))


def test_the_wrench_of_the_base_gives_the_links_without_their_friction(client: TestClient, robot: str) -> None:
    measurement = upload(client, robot, recording(), units={"base_force": "kN"})
    assert measurement["has_wrench"]
    done = identified(client, robot, measurement)
    assert done["status"] == "succeeded", done
    found = {one["name"]: one for one in done["result"]["parameters"]}
    assert {one["effect"] for one in found.values()} == {"rigid_body"}
    # The quill's mass hangs on its prismatic joint alone: what the base feels of its acceleration.
    quill = found["M3"]
    truth = ROBOT.inertias[2:, 9].sum()
    assert abs(quill["value"] - truth) < 4 * quill["standard_deviation"] < truth
    assert any("friction and rotors are not in this model" in warning for warning in done["result"]["warnings"])


def test_a_file_without_the_wrench_is_refused_by_name(client: TestClient, robot: str) -> None:
    measurement = upload(client, robot, recording(with_wrench=False))
    assert not measurement["has_wrench"]
    done = identified(client, robot, measurement)
    assert done["status"] == "failed"
    assert "has no wrench of the base" in json.dumps(done)
