"""A file is looked at, its columns are told, and it is used without being uploaded again."""

from __future__ import annotations

import io
import json
from datetime import timedelta
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, wait_for
from support.measurement_uploads import as_csv, sound

from dynident_service.storage.deletion_and_expiry import delete_unused_imports


def foreign(decimal: str = ",") -> bytes:
    """The recording of other tests as another logger would write it: other names, degrees, ms, decimal commas."""
    columns = sound()
    theirs = {"Zeit [ms]": columns["t"] * 1e3}
    theirs |= {f"A{j} Moment [Nm]": columns[f"tau{j}"] for j in (2, 1)}
    theirs |= {f"A{j} Winkel [°]": np.rad2deg(columns[f"q{j}"]) for j in (2, 1)}
    text = io.StringIO()
    np.savetxt(text, np.column_stack(list(theirs.values())), delimiter=";", header=";".join(theirs), comments="")
    return text.getvalue().replace(".", decimal).encode()


def imported(client: TestClient, robot: dict[str, Any], content: bytes, **said: Any) -> Any:
    form = {"metadata": json.dumps({"robot_id": robot["id"], **said})}
    return client.post("/v1/imports", files={"file": ("day one.csv", content)}, data=form)


def test_a_foreign_file_is_proposed_and_becomes_a_measurement_in_one_call(client, robot):
    answer = imported(client, robot, foreign())
    assert answer.status_code == 201, answer.text
    found = answer.json()
    assert found["questions"] == []
    assert found["proposed"]["columns"]["q2"] == "A2 Winkel [°]"
    assert found["proposed"]["units"] == {"t": "ms", "q": "deg"}
    assert found["proposed"]["name"] == "day one"
    assert found["effort_kind"] == "joint_torque"
    assert found["preview"]["columns"][0] == "Zeit [ms]"
    assert len(found["preview"]["rows"][0]) == 5
    assert {"field", "value", "confidence", "reason", "remedies"} == set(found["guesses"][0])
    assert client.get(f"/v1/imports/{found['id']}").json() == found
    assert client.get("/v1/imports").json()["items"][0] == found

    used = client.post("/v1/measurements", json={"import_id": found["id"], "metadata": found["proposed"]})
    assert used.status_code == 201, used.text
    measurement = used.json()
    assert measurement["sha256"] == found["sha256"]
    assert measurement["effort_kind"] == "joint_torque"
    assert measurement["sampling_rate"] == pytest.approx(200.0)
    content = client.get(f"/v1/measurements/{measurement['id']}/content").content
    assert content == foreign()


def test_telegrams_of_a_robot_are_proposed_and_their_drive_gains_asked_for(client, robot):
    s = sound()
    lines = [
        f'<Rob Type="KUKA"><AIPos A1="{np.rad2deg(a):.5f}" A2="{np.rad2deg(b):.5f}"/>'
        f'<ASPos A1="{np.rad2deg(a):.3f}" A2="{np.rad2deg(b):.3f}"/><MACur A1="{0.1 * c:.4f}" A2="{0.1 * d:.4f}"/>'
        f"<IPOC>{round(1e3 * t) + 9}</IPOC></Rob>"
        for t, a, b, c, d in zip(s["t"], s["q1"], s["q2"], s["tau1"], s["tau2"], strict=True)
    ]
    found = imported(client, robot, "\n".join(lines).encode()).json()
    assert found["format"] == "rsi"
    assert found["proposed"]["units"] == {"t": "ms", "q": "deg"}
    assert found["proposed"]["columns"]["q2"] == "AIPos.A2"
    assert found["proposed"]["columns"]["current1"] == "MACur.A1"
    assert [one["field"] for one in found["questions"]] == ["drives"]


def without_names(values: np.ndarray) -> bytes:
    text = io.StringIO()
    np.savetxt(text, values)
    return text.getvalue().encode()


def separate_files() -> list[tuple[str, tuple[str, bytes]]]:
    """Positions and torques of the same recording in two files, without names and time."""
    s = sound()
    q, tau = (without_names(np.column_stack([s[f"{kind}{j}"] for j in (1, 2)])) for kind in ("q", "tau"))
    return [("file", ("q.csv", q)), ("further", ("tau.csv", tau))]


def test_a_recording_in_two_files_without_time_is_joined_at_a_stated_rate(client, robot):
    said = {"metadata": json.dumps({"robot_id": robot["id"], "rate": 200.0})}
    answer = client.post("/v1/imports", files=separate_files(), data=said)
    assert answer.status_code == 201, answer.text
    found = answer.json()
    assert found["questions"] == []
    assert (found["format"], found["proposed"]["rate"]) == ("zip", 200.0)
    used = client.post("/v1/measurements", json={"import_id": found["id"], "metadata": found["proposed"]})
    assert used.status_code == 201, used.text
    raw = client.get(f"/v1/measurements/{used.json()['id']}/raw").json()
    np.testing.assert_allclose(raw["signals"]["tau2"], sound()["tau2"])
    assert raw["t"][1] == pytest.approx(0.005)

    metadata = {"robot_id": robot["id"], "name": "both", "rate": 200.0, "columns": found["proposed"]["columns"]}
    sent = client.post("/v1/measurements", files=separate_files(), data={"metadata": json.dumps(metadata)})
    assert sent.status_code == 201, sent.text
    assert sent.json()["sha256"] == found["sha256"]
    assert [one["name"] for one in sent.json()["checks"]].count("layout") == 1


def test_files_that_cannot_be_joined_are_refused_with_the_reason(client, robot):
    said = {"metadata": json.dumps({"robot_id": robot["id"]})}
    same = [(kind, ("q.csv", content)) for kind, (_, content) in separate_files()]
    refused = client.post("/v1/imports", files=same, data=said)
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["pointer"] == "/further"
    alone = client.post("/v1/imports", files=separate_files()[:1], data=said).json()
    assert "rate" in alone["questions"][0]["detail"]
    short = [separate_files()[0], ("further", ("tau.csv", separate_files()[1][1][1][:-2000]))]
    answer = client.post(
        "/v1/imports", files=short, data={"metadata": json.dumps({"robot_id": robot["id"], "rate": 1.0})}
    )
    assert answer.status_code == 422
    assert "ends after" in answer.json()["detail"]


def test_what_is_said_beforehand_is_not_guessed(client, robot):
    found = imported(client, robot, foreign(), columns={"q1": "A2 Winkel [°]", "q2": "A1 Winkel [°]"}).json()
    assert found["proposed"]["columns"]["q1"] == "A2 Winkel [°]"


def test_a_body_that_names_no_import_says_so(client, robot):
    metadata = {"robot_id": robot["id"], "name": "run"}
    answer = client.post("/v1/measurements", json={"import_id": "imp_0", "metadata": metadata})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/import_id"
    answer = client.post("/v1/measurements", json={"metadata": metadata})
    assert answer.json()["errors"][0]["pointer"] == "/import_id"
    answer = client.post("/v1/measurements", content=b"{", headers={"content-type": "application/json"})
    assert (answer.status_code, "JSON" in answer.json()["detail"]) == (422, True)


def test_a_file_that_cannot_be_read_is_refused(client, robot):
    answer = imported(client, robot, b"")
    assert answer.status_code == 422
    assert "empty" in answer.json()["detail"]


def test_imports_that_nobody_uses_are_forgotten_after_a_day(client, services, robot):
    unused, used = (imported(client, robot, foreign(decimal)).json() for decimal in (",", "."))
    answer = client.post("/v1/measurements", json={"import_id": used["id"], "metadata": used["proposed"]})
    assert answer.status_code == 201, answer.text
    assert delete_unused_imports(services.database, timedelta(days=1)) == 0
    assert client.get(f"/v1/imports/{unused['id']}").status_code == 200
    assert delete_unused_imports(services.database, timedelta(0)) >= 1
    assert client.get(f"/v1/imports/{unused['id']}").status_code == 404
    assert client.get(f"/v1/imports/{used['id']}").status_code == 200


@pytest.mark.parametrize("kind", ["gravity_compensated", "external", "commanded"])
def test_torque_that_is_no_measurement_is_refused_with_that_word(client, robot, kind):
    found = imported(client, robot, foreign()).json()
    metadata = found["proposed"] | {"effort_kind": kind}
    answer = client.post("/v1/measurements", json={"import_id": found["id"], "metadata": metadata})
    assert answer.status_code == 422
    assert kind.replace("_", "-") in answer.json()["detail"]


def test_commands_of_servos_without_torque_are_proposed_and_identified_but_not_diagnosed(client):
    columns, gain = sound(), 1000.0
    for joint in (1, 2):
        columns[f"q_command{joint}"] = columns[f"q{joint}"] + columns.pop(f"tau{joint}") / gain
    body = {"name": "servos", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
    plain = client.post("/v1/robots", json=body).json()
    asked = imported(client, plain, as_csv(columns)).json()
    assert asked["proposed"]["effort_kind"] == asked["effort_kind"] == "position_command"
    assert [one["field"] for one in asked["questions"]] == ["drives"]
    drives = {joint["name"]: {"drive_gain": gain} for joint in plain["joints"]}
    robot = client.post("/v1/robots", json=body | {"drives": drives}).json()
    found = imported(client, robot, as_csv(columns)).json()
    assert found["questions"] == []
    answer = client.post("/v1/measurements", json={"import_id": found["id"], "metadata": found["proposed"]})
    assert answer.status_code == 201, answer.text
    measurement = answer.json()
    assert measurement["effort_kind"] == "position_command"
    assert "back-EMF" in next(one["detail"] for one in measurement["checks"] if one["name"] == "torque_source")
    body = {"robot_id": robot["id"], "measurement_ids": [measurement["id"]]}
    model = client.post("/v1/identifications", json=body).json()["id"]

    def ended(path: str) -> Any:
        shown = client.get(path).json()
        return shown if shown["status"] in ("succeeded", "failed") else None

    assert wait_for(lambda: ended(f"/v1/identifications/{model}"), 120.0)["status"] == "succeeded"
    diagnosis = client.post("/v1/diagnoses", json={"identification_id": model}).json()["id"]
    refused = wait_for(lambda: ended(f"/v1/diagnoses/{diagnosis}"), 120.0)
    assert refused["status"] == "failed"
    assert "no torque was recorded" in json.dumps(refused)
