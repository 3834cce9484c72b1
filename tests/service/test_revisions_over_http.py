"""A stored measurement is revised without another upload; what a check proposes can be posted as it is."""

from __future__ import annotations

from typing import Any

from fastapi.testclient import TestClient
from service_helpers import wait_for
from support.measurement_uploads import as_csv, sound, upload


def revise(client: TestClient, measurement: dict[str, Any], **change: Any) -> Any:
    return client.post(f"/v1/measurements/{measurement['id']}/revisions", json=change)


def test_a_revision_is_a_measurement_of_the_same_file(client: TestClient, robot: dict[str, Any]) -> None:
    content = as_csv(sound())
    first = upload(client, robot, content).json()
    answer = revise(client, first, windows=[[1.0, 6.0]])
    assert answer.status_code == 201, answer.text
    second = answer.json()
    assert answer.headers["location"] == f"/v1/measurements/{second['id']}"
    assert (second["parent_id"], second["revision"], second["sha256"]) == (first["id"], 1, first["sha256"])
    assert second["windows"] == [[1.0, 6.0]]
    assert second["edits"] == [{"windows": [[1.0, 6.0]]}]
    assert client.get(f"/v1/measurements/{second['id']}/content").content == content
    third = revise(client, second, exclude=[[2.0, 3.0]], name="mine").json()
    assert third["edits"] == [{"windows": [[1.0, 6.0]]}, {"exclude": [[2.0, 3.0]], "name": "mine"}]
    assert (third["name"], third["revision"], third["request"]["windows"]) == ("mine", 2, [[1.0, 6.0]])
    again = client.get(f"/v1/measurements/{first['id']}").json()
    assert (again["windows"], again["parent_id"], again["edits"]) == ([], None, [])


def test_a_parent_stays_as_long_as_its_revisions_do(client: TestClient, robot: dict[str, Any]) -> None:
    first = upload(client, robot, as_csv(sound())).json()
    second = revise(client, first, windows=[[1.0, 6.0]]).json()
    assert client.delete(f"/v1/measurements/{first['id']}").status_code == 409
    assert client.delete(f"/v1/measurements/{second['id']}").status_code == 204
    assert client.get(f"/v1/measurements/{first['id']}/content").status_code == 200
    assert client.delete(f"/v1/measurements/{first['id']}").status_code == 204


def test_what_a_check_proposes_cures_what_it_found(client: TestClient, robot: dict[str, Any]) -> None:
    columns = sound()
    columns["tau2"] = -columns["tau2"]
    # Of two joints, one that seems turned may be a passive one: the cure is proposed, and nothing is refused.
    accepted = upload(client, robot, as_csv(columns)).json()
    (found,) = [one for one in accepted["checks"] if one["status"] == "warning"]
    assert found["apply"] == {"signs": {"tau2": -1.0}}
    answer = revise(client, accepted, **found["apply"])
    assert answer.status_code == 201, answer.text
    assert {one["status"] for one in answer.json()["checks"] if one["name"] == found["name"]} == {"ok"}
    directly = upload(client, robot, as_csv(columns), **found["apply"])
    assert directly.status_code == 201, directly.text


def test_a_revision_that_cannot_be_is_refused_with_its_field(client: TestClient, robot: dict[str, Any]) -> None:
    first = upload(client, robot, as_csv(sound())).json()
    assert revise(client, first).status_code == 422
    assert revise(client, {"id": "m_nothing"}, name="x").status_code == 404
    for change, pointer in (
        ({"permutation": {"tau": [1, 1]}}, "/permutation/tau"),
        ({"windows": [[3.0, 1.0]]}, "/windows/0"),
        ({"windows": [[300.0, 400.0]]}, "/windows/0"),
        ({"units": {"q": "furlong"}}, "/units/q"),
        ({"torque_delay": 5.0}, "/torque_delay"),
        ({"wheels": 3}, "/wheels"),
    ):
        answer = revise(client, first, **change)
        assert answer.status_code == 422, change
        assert answer.json()["errors"][0]["pointer"] == pointer


def test_a_repeated_request_makes_one_revision(client: TestClient, robot: dict[str, Any]) -> None:
    first = upload(client, robot, as_csv(sound())).json()
    path, headers = f"/v1/measurements/{first['id']}/revisions", {"Idempotency-Key": f"revision {first['id']}"}
    ids = {client.post(path, json={"windows": [[1, 6]]}, headers=headers).json()["id"] for _ in range(2)}
    assert len(ids) == 1


def test_a_model_says_which_revision_it_saw(client: TestClient, robot: dict[str, Any]) -> None:
    first = upload(client, robot, as_csv(sound())).json()
    second = revise(client, first, windows=[[0.5, 9.0]]).json()
    body = {"robot_id": robot["id"], "measurement_ids": [second["id"]], "validation_ids": [first["id"]]}
    made = client.post("/v1/identifications", json=body).json()

    def ended() -> Any:
        found = client.get(f"/v1/identifications/{made['id']}").json()
        return found if found["status"] in ("succeeded", "failed") else None

    seen = wait_for(ended, 120.0)["result"]["measurements"]
    assert [(one["id"], one["role"], one["revision"]) for one in seen] == [
        (second["id"], "identification", 1),
        (first["id"], "validation", 0),
    ]
    assert seen[0]["edits"] == [{"windows": [[0.5, 9.0]]}]
    assert seen[0]["sha256"] == seen[1]["sha256"]
