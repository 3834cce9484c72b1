"""The verdict of a model over HTTP: uses with reasons, a stop with its cure, and no export of what is stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from fastapi.testclient import TestClient
from service_helpers import wait_for
from support.measurement_uploads import as_csv, sound, upload

from dynident.verdict import Action, State, UseName
from dynident_service.identifications.jobs import SentCheck, SentMeasurement, build_checks
from dynident_service.identifications.wire_types import UseView
from dynident_service.interactive_compute import InteractiveCompute
from dynident_service.jobs.task_input_output import LruCache


def identified(client: TestClient, robot: dict[str, Any], fitted: str, held_out: list[str]) -> str:
    body = {"robot_id": robot["id"], "measurement_ids": [fitted], "validation_ids": held_out}
    made = client.post("/v1/identifications", json=body).json()["id"]

    def ended() -> Any:
        found = client.get(f"/v1/identifications/{made}").json()
        return found if found["status"] in ("succeeded", "failed") else None

    assert wait_for(ended, 120.0)["status"] == "succeeded"
    return str(made)


def other(n_rows: int = 2000) -> dict[str, np.ndarray]:
    """The same robot along another motion."""
    t = np.arange(n_rows) / 200.0
    columns = {"t": t}
    for joint, (frequency, inertia) in enumerate(((0.23, 8.0), (0.61, 3.0)), start=1):
        w = 2 * np.pi * frequency
        q, dq, ddq = np.zeros(n_rows), np.zeros(n_rows), np.zeros(n_rows)
        for k, size in ((1, 0.7), (2, 0.2), (3, 0.1)):
            q += size * np.sin(k * w * t + 2 * k + joint)
            dq += size * k * w * np.cos(k * w * t + 2 * k + joint)
            ddq -= size * (k * w) ** 2 * np.sin(k * w * t + 2 * k + joint)
        noise = np.random.default_rng(5 + joint).normal(0, 0.1, n_rows)
        columns |= {f"q{joint}": q, f"tau{joint}": inertia * ddq + 4.0 * np.sign(dq) + 3.0 * dq + noise}
    return columns


def test_a_verdict_tells_each_use_with_its_reason(
    client: TestClient, robot: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = upload(client, robot, as_csv(sound())).json()["id"]
    model = identified(client, robot, fitted, [upload(client, robot, as_csv(other())).json()["id"]])
    answer = client.get(f"/v1/identifications/{model}/verdict")
    assert answer.status_code == 200, answer.text
    found = answer.json()
    assert {one["use"] for one in found["uses"]} == {"simulation", "feed_forward", "collision_detection", "payload"}
    assert next(one for one in found["uses"] if one["use"] == "feed_forward")["fit"]
    assert all(one["reason"] for one in found["uses"])
    result = client.get(f"/v1/identifications/{model}").json()["result"]
    assert found["held_out"]["relative_total"] == result["validation"]["relative_total"]
    assert found["stop"] is None
    assert client.get(f"/v1/identifications/{model}/export").status_code == 200
    # A model never changes: what was said of it once is there at once.
    monkeypatch.setattr(InteractiveCompute, "call", None)
    assert client.get(f"/v1/identifications/{model}/verdict").json() == found
    # In a list nobody looks for parameters, which are most of it; all else is there.
    for brief, expected in ((True, {**result, "parameters": []}), (False, result)):
        listed = client.get("/v1/identifications", params={"brief": brief}).json()["items"]
        assert next(one for one in listed if one["id"] == model)["result"] == expected
    client.delete(f"/v1/identifications/{model}")
    assert client.get(f"/v1/identifications/{model}/verdict").status_code == 404


def test_what_is_remembered_longest_ago_is_forgotten() -> None:
    kept: LruCache[int] = LruCache(2)
    kept.put("a", 1)
    kept.put("b", 2)
    assert kept.get("a") == 1
    kept.put("c", 3)
    assert [kept.get(one) for one in "abc"] == [1, None, 3]


def test_a_stop_names_the_measurement_and_its_cure(client: TestClient, robot: dict[str, Any]) -> None:
    fitted = upload(client, robot, as_csv(sound())).json()["id"]
    columns = other()
    columns["tau1"], columns["tau2"] = columns["tau2"], columns["tau1"]
    accept = ["torque_order", "torque_sign", "joint_order", "joint_sign"]
    wrong = upload(client, robot, as_csv(columns), accept=accept).json()["id"]
    model = identified(client, robot, fitted, [wrong])
    stop = client.get(f"/v1/identifications/{model}/verdict").json()["stop"]
    assert stop["measurement_id"] == wrong
    # Torques or positions stand in each other's place, which nothing tells: no cure is ordered.
    assert stop["apply"] is None
    assert "These data fit equally well" in stop["cause"]
    cure = {"permutation": {"tau": [2, 1]}}
    right = client.post(f"/v1/measurements/{wrong}/revisions", json=cure).json()["id"]
    refused = client.get(f"/v1/identifications/{model}/export")
    assert refused.status_code == 409
    assert "anyway=true" in refused.json()["detail"]
    assert client.get(f"/v1/identifications/{model}/export", params={"anyway": True}).status_code == 200
    again = client.get(f"/v1/identifications/{identified(client, robot, fitted, [right])}/verdict").json()
    assert again["stop"] is None


def test_an_accepted_finding_vetoes_no_use_whatever_its_sentence_says(
    tmp_path: Path, client: TestClient, robot: dict[str, Any]
) -> None:
    uploaded = upload(client, robot, as_csv(sound()), accept=["torque_size"]).json()
    request = {"robot_id": robot["id"], "name": "run", "accept": uploaded["request"]["accept"]}
    assert request["accept"] == ["torque_size"]
    check: SentCheck = {"name": "torque_size", "status": "warning", "detail": "too small"}
    for accepted, expected in ((request["accept"], True), ([], False)):
        sent: SentMeasurement = {
            "id": uploaded["id"],
            "recording": str(tmp_path),
            "request": {**request, "accept": accepted},
            "checks": [check],
        }
        assert [one.is_accepted for one in build_checks(sent)] == [expected]


@pytest.mark.parametrize(("accept", "is_told"), [([], True), (["torque_delay"], False)])
def test_a_diagnosis_names_the_check_to_heed_first(
    client: TestClient, robot: dict[str, Any], accept: list[str], is_told: bool
) -> None:
    columns = sound()
    late = {name: np.roll(values, 8) if name.startswith("tau") else values for name, values in columns.items()}
    fitted = upload(client, robot, as_csv({name: values[8:] for name, values in late.items()}), accept=accept).json()
    model = identified(client, robot, fitted["id"], [])
    made = client.post("/v1/diagnoses", json={"identification_id": model}).json()["id"]

    def ended() -> Any:
        found = client.get(f"/v1/diagnoses/{made}").json()
        return found if found["status"] in ("succeeded", "failed") else None

    result = wait_for(ended, 120.0)["result"]
    first = "First correct what the check torque delay of"
    assert (result["summary"].startswith(first), result["conclusion"]["next_step"].startswith(first)) == 2 * (is_told,)


def test_the_same_content_uploaded_twice_is_noticed(client: TestClient, robot: dict[str, Any]) -> None:
    ids = [upload(client, robot, as_csv(sound()), name=name).json()["id"] for name in ("run", "run")]
    found = client.get(f"/v1/identifications/{identified(client, robot, ids[0], ids[1:])}/verdict").json()
    (common,) = found["common"]
    assert (common["kind"], common["held_out_id"], common["fitted_id"]) == ("copied", ids[1], ids[0])
    assert found["stop"]["measurement_id"] == ids[1]
    assert {one["state"] for one in found["uses"]} == {"not_judged"}


def test_a_model_that_was_tried_on_its_own_samples_is_not_exported(client: TestClient, robot: dict[str, Any]) -> None:
    ids = [upload(client, robot, as_csv(sound()), name=name).json()["id"] for name in ("run", "again")]
    model = identified(client, robot, ids[0], ids[1:])
    assert client.get(f"/v1/identifications/{model}").json()["result"]["copied"] == ["again"]
    refused = client.get(f"/v1/identifications/{model}/export")
    assert refused.status_code == 409
    assert "samples of the fit" in refused.json()["detail"]
    assert client.get(f"/v1/identifications/{model}/export", params={"anyway": True}).status_code == 200


def test_a_validation_that_fails_revises_the_verdict_of_its_use(client: TestClient, robot: dict[str, Any]) -> None:
    fitted = upload(client, robot, as_csv(sound())).json()["id"]
    model = identified(client, robot, fitted, [upload(client, robot, as_csv(other())).json()["id"]])

    def states() -> dict[str, str]:
        uses = client.get(f"/v1/identifications/{model}/verdict").json()["uses"]
        assert all(one["next_step"] for one in uses)
        return {one["use"]: one["state"] for one in uses}

    before = states()
    assert before["feed_forward"] == "yes"
    body = {"identification_id": model, "kind": "cross", "limit": 1e-6}
    made = client.post("/v1/validations", json=body).json()["id"]

    def ended() -> Any:
        found = client.get(f"/v1/validations/{made}").json()
        return found if found["status"] in ("succeeded", "failed") else None

    assert wait_for(ended, 60.0)["result"]["verdict"] == "fail"
    assert states()["feed_forward"] == "no"


def test_a_model_that_is_not_there_has_no_verdict(client: TestClient) -> None:
    assert client.get("/v1/identifications/ide_none/verdict").status_code == 404


def test_the_contract_names_every_use_state_and_action_of_the_library() -> None:
    properties = UseView.model_json_schema()["properties"]
    (actions,) = [choice["enum"] for choice in properties["next_action"]["anyOf"] if "enum" in choice]
    named = (properties["use"]["enum"], properties["state"]["enum"], actions)
    assert [set(names) for names in named] == [set(get_args(kind)) for kind in (UseName, State, Action)]
