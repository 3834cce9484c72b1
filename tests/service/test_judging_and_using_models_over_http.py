"""Reasons, detection limits, verdicts with their values, and predicted torque over HTTP."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, wait_for
from support.measurement_uploads import as_csv, sound, upload

from dynident.export import model_from_json


def wait(client: TestClient, path: str) -> dict[str, Any]:
    def ended() -> Any:
        shown = client.get(path).json()
        return shown if shown["status"] in ("succeeded", "failed") else None

    shown = wait_for(ended, 120.0)
    assert shown["status"] == "succeeded", shown
    return dict(shown)


@pytest.fixture(scope="module")
def model(client: TestClient) -> str:
    description = {"format": "modified_dh", "content": TWO_JOINTS}
    robot = client.post("/v1/robots", json={"name": "arm", "description": description}).json()
    run = upload(client, robot, as_csv(sound())).json()["id"]
    body = {"robot_id": robot["id"], "measurement_ids": [run]}
    identifier = client.post("/v1/identifications", json=body).json()["id"]
    wait(client, f"/v1/identifications/{identifier}")
    return str(identifier)


def test_reasons_and_limits_of_a_diagnosis(client: TestClient, model: str) -> None:
    identifier = client.post("/v1/diagnoses", json={"identification_id": model}).json()["id"]
    result = wait(client, f"/v1/diagnoses/{identifier}")["result"]
    outcome = next(one for one in result["outcomes"] if one["joints"])
    where = {"effect": outcome["effect"], "joint": outcome["joints"][0]}
    first = result["candidates"][0]
    assert [one["code"] for one in first["reasons"]] == [first["reason"]["code"]]
    reason = client.get(f"/v1/diagnoses/{identifier}/why", params=where)
    assert reason.status_code == 200, reason.text
    of_effect = [one for one in result["outcomes"] if one["effect"] == where["effect"]]
    assert reason.json() in [one["reason"] for one in of_effect]
    unknown = client.get(f"/v1/diagnoses/{identifier}/why", params={"effect": "no_such"})
    assert unknown.status_code == 422
    assert "no_such" in unknown.json()["detail"]
    limits = client.get(f"/v1/diagnoses/{identifier}/limits").json()
    assert len(limits) == len(result["detection_limits"]) > 0
    for row, limit in zip(limits, result["detection_limits"], strict=True):
        assert row == {
            "effect": limit["effect"],
            "joint": limit["joints"][0] if limit["joints"] else None,
            "parameter": limit["parameter"],
            "limit": limit["size"],
            "unit": limit["unit"],
            "of_usual": limit["share"],
        }


def test_what_was_put_right_is_listed_and_can_be_undone(client: TestClient, robot: dict[str, Any]) -> None:
    columns = sound()
    columns["q2"][700] += 0.9
    stored = upload(client, robot, as_csv(columns))
    assert stored.status_code == 201, stored.text
    (correction,) = stored.json()["conditioning"]
    assert correction["code"] == "corrupted_samples"
    assert correction["subject"] == {"recording": "run", "column": "q2", "joint": robot["joints"][1]["name"]}
    # Data rows are counted from 1.
    assert correction["rows"] == {"count": 1, "first": [701]}
    check = next(check for check in stored.json()["checks"] if check["code"] == "corrupted_samples")
    remedy = {"field": "skip", "value": ["corrupted_samples"], "text": '"skip": ["corrupted_samples"]'}
    assert check["remedies"] == [remedy]
    assert check["remedy"] == remedy
    assert remedy["text"] in check["detail"]
    assert (check["values"]["column"], check["values"]["row"]) == ("q2", 701)
    undone = client.post(f"/v1/measurements/{stored.json()['id']}/revisions", json=correction["undo"])
    assert undone.status_code == 201, undone.text
    assert undone.json()["conditioning"] == []


def test_what_was_put_right_names_the_joint_whose_whole_name_the_column_has(client: TestClient) -> None:
    names = ["arm", "left_arm"]
    joints = [{**joint, "name": name} for joint, name in zip(TWO_JOINTS["joints"], names, strict=True)]
    description = {"format": "modified_dh", "content": {"joints": joints}}
    robot = client.post("/v1/robots", json={"name": "two arms", "description": description}).json()
    columns = {
        name if name == "t" else f"{name[:-1]}_{names[int(name[-1]) - 1]}": value for name, value in sound().items()
    }
    columns["q_left_arm"][700] += 0.9
    stored = upload(client, robot, as_csv(columns))
    assert stored.status_code == 201, stored.text
    (correction,) = stored.json()["conditioning"]
    assert correction["subject"] == {"recording": "run", "column": "q_left_arm", "joint": "left_arm"}


def test_a_use_without_data_is_neither_fit_nor_unfit(client: TestClient, model: str) -> None:
    uses = client.get(f"/v1/identifications/{model}/verdict").json()["uses"]
    assert {use["fit"] for use in uses if use["state"] == "not_judged"} == {None}
    assert all(use["test"].endswith("?") and use["next"]["sentence"] == use["next_step"] for use in uses)


def test_predicted_torque_is_that_of_the_parameters(client: TestClient, model: str) -> None:
    q, dq, ddq = np.random.default_rng(4).normal(size=(3, 5, 2))
    body = {"q": q.tolist(), "dq": dq.tolist(), "ddq": ddq.tolist()}
    path = f"/v1/identifications/{model}/predictions"
    answer = client.post(path, json=body)
    assert answer.status_code == 200, answer.text
    torque = np.array(answer.json()["torque"])
    exported = model_from_json(client.get(f"/v1/identifications/{model}/export").text)
    expected = [exported.predictor().step(*state) for state in zip(q, dq, ddq, strict=True)]
    assert torque == pytest.approx(np.array(expected))
    assert answer.json()["lower"] is None
    wide, narrow = (client.post(path, json={**body, "interval": level}).json() for level in (0.95, 0.5))
    assert np.array(wide["torque"]) == pytest.approx(torque)
    assert (np.array(wide["lower"]) < np.array(narrow["lower"])).all()
    assert (np.array(wide["model_upper"]) <= np.array(wide["upper"])).all()
    # Rows of their own give what they give together: this model remembers nothing.
    steady = client.post(path, json={key: [rows[2]] for key, rows in body.items()} | {"steady": True}).json()
    assert np.array(steady["torque"])[0] == pytest.approx(torque[2])


@pytest.mark.parametrize(
    ("changed", "pointer"),
    [
        ({"q": [[0.0, 0.0, 0.0]]}, "/q"),
        ({"dq": [[0.0, 0.0], [0.0]]}, "/dq"),
        ({"t": [0.0, 1.0]}, "/t"),
        ({"interval": 1.0}, "/interval"),
        ({"q": []}, "/q"),
    ],
)
def test_rows_that_do_not_fit_are_refused(
    client: TestClient, model: str, changed: dict[str, object], pointer: str
) -> None:
    body = {"q": [[0.0, 0.0]], "dq": [[0.0, 0.0]], "ddq": [[0.0, 0.0]], **changed}
    answer = client.post(f"/v1/identifications/{model}/predictions", json=body)
    assert answer.status_code == 422, answer.text
    assert [error["pointer"] for error in answer.json()["errors"]] == [pointer]


def test_a_format_that_there_is_not_is_named_by_its_parameter(client: TestClient, model: str) -> None:
    refused = client.get(f"/v1/identifications/{model}/exports/word")
    assert refused.status_code == 422
    (error,) = refused.json()["errors"]
    assert error["pointer"] == "format"
    assert "'urdf'" in error["detail"]
    assert "'cpp'" in error["detail"]
