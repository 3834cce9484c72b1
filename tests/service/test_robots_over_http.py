from __future__ import annotations

import copy
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS
from support.closed_loop_robots import machine, mjcf
from support.floating_robots import WALKER

from dynident.robot import library_names, robot_from_library
from dynident.robot.description_formats import BASE_JOINTS

BODY: dict[str, Any] = {
    "name": "arm",
    "description": {"format": "modified_dh", "content": TWO_JOINTS},
    "limits": {"shoulder": {"position": [-1, 2], "velocity": 3}},
    "drives": {"elbow": {"drive_gain": 11.5}},
}


def test_a_robot_comes_back_with_its_joints_and_base_parameters(client: TestClient) -> None:
    answer = client.post("/v1/robots", json=BODY)
    robot = answer.json()
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/v1/robots/{robot['id']}"
    assert [joint["name"] for joint in robot["joints"]] == ["shoulder", "elbow"]
    assert robot["joints"][0]["limits"]["position"] == [-1, 2]
    assert robot["joints"][1]["drive_gain"] == 11.5
    # A planar arm with two parallel axes and gravity along them: ZZ1 + 0.25 M2, ZZ2, MX2, MY2.
    assert robot["base_parameters"] == {
        "count": 4,
        "rank": 4,
        "names": ["ZZ1", "ZZ2", "MX2", "MY2"],
        "groupings": ["ZZ1 + 0.25 M2", "ZZ2", "MX2", "MY2"],
    }
    assert client.get(answer.headers["location"]).json() == robot


def test_a_modified_dh_table_may_be_json_or_its_text(client: TestClient) -> None:
    import json

    as_text = {**BODY, "description": {"format": "modified_dh", "content": json.dumps(TWO_JOINTS)}}
    one, other = (client.post("/v1/robots", json=body).json() for body in (BODY, as_text))
    assert one["base_parameters"] == other["base_parameters"]


def test_a_machine_with_a_loop_is_made_from_its_mjcf_and_a_bad_one_is_refused_with_the_line(client: TestClient) -> None:
    text = mjcf(machine("five_bar"))
    body = {"name": "five-bar", "description": {"format": "mjcf", "content": text}}
    answer = client.post("/v1/robots", json=body)
    assert answer.status_code == 201
    assert [joint["name"] for joint in answer.json()["joints"]] == ["left", "right"]
    again = client.get(f"/v1/robots/{answer.json()['id']}").json()
    assert again["base_parameters"]["count"] > 5
    body["description"]["content"] = "<mujoco>\n<include file='/etc/hosts'/></mujoco>"
    refused = client.post("/v1/robots", json=body)
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["pointer"] == "/description/content"
    assert "line 2: <include> adds elements" in refused.json()["errors"][0]["detail"]


def test_a_retry_with_the_same_idempotency_key_makes_no_second_robot(client: TestClient) -> None:
    first, second = (client.post("/v1/robots", json=BODY, headers={"Idempotency-Key": "k1"}) for _ in range(2))
    assert first.json()["id"] == second.json()["id"]
    assert second.status_code == 201
    assert second.headers["location"] == first.headers["location"]
    assert second.headers["idempotency-replayed"] == "true"
    assert "idempotency-replayed" not in first.headers


def test_an_idempotency_key_used_for_another_request_is_refused(client: TestClient) -> None:
    client.post("/v1/robots", json=BODY, headers={"Idempotency-Key": "k2"})
    answer = client.post("/v1/robots", json={**BODY, "name": "another"}, headers={"Idempotency-Key": "k2"})
    assert answer.status_code == 422
    assert "k2" in answer.json()["detail"]


def test_a_robot_is_deleted_and_then_gone(client: TestClient) -> None:
    path = client.post("/v1/robots", json=BODY).headers["location"]
    assert client.delete(path).status_code == 204
    assert client.get(path).status_code == 404
    assert client.delete(path).status_code == 404


def test_pages_give_every_robot_once_newest_first(client: TestClient) -> None:
    made = [client.post("/v1/robots", json={**BODY, "name": f"page {k}"}).json()["id"] for k in range(5)]
    seen: list[str] = []
    cursor = None
    while True:
        page = client.get("/v1/robots", params={"limit": 2, **({"cursor": cursor} if cursor else {})}).json()
        assert len(page["items"]) <= 2
        seen += [robot["id"] for robot in page["items"]]
        cursor = page["cursor"]
        if cursor is None:
            break
    assert len(seen) == len(set(seen))
    assert set(made) <= set(seen)
    assert seen == sorted(seen, reverse=True)


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"name": None}, "/name"),
        ({"name": ""}, "/name"),
        ({"surname": "x"}, "/surname"),
        ({"description": {"format": "sdf", "content": ""}}, "/description/format"),
        ({"description": {"format": "urdf", "content": "<robot"}}, "/description/content"),
        ({"description": {"format": "urdf"}}, "/description/content"),
        ({"limits": {"wrist": {}}}, "/limits/wrist"),
        ({"limits": {"elbow": {"position": [2, 1]}}}, "/limits/elbow/position"),
        ({"drives": {"elbow": {"drive_gain": "much"}}}, "/drives/elbow/drive_gain"),
        ({"drives": {"elbow": {"gear_ratio": 0}}}, "/drives/elbow/gear_ratio"),
        ({"gravity": [0, 0]}, "/gravity/2"),
        ({"locked_joints": {"shoulder": 0, "elbow": 0}, "drives": {}, "limits": {}}, "/locked_joints"),
    ],
)
def test_what_is_wrong_with_a_robot_is_pointed_at(client: TestClient, change: dict[str, Any], pointer: str) -> None:
    answer = client.post("/v1/robots", json={**copy.deepcopy(BODY), **change})
    problem = answer.json()
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert pointer in [field["pointer"] for field in problem["errors"]]
    assert problem["detail"]


def test_the_catalogue_says_what_every_effect_is(client: TestClient) -> None:
    items = client.get("/v1/effects").json()["items"]
    assert {"rigid_body", "rotor_inertia", "coulomb", "viscous", "offset", "stribeck"} <= {one["id"] for one in items}
    for one in items:
        assert one["title"]
        assert one["formula"]
        assert one["sources"]
        assert all(parameter["unit"] and parameter["description"] for parameter in one["parameters"])
    kinds = {one["id"]: {c["name"]: c["words"] for c in one["shape_parameters"]} for one in items}
    assert {"value": -1.0, "word": "dahl"} in kinds["presliding"]["law"]
    assert kinds["presliding"]["d0"] == []


def test_well_known_arms_are_listed_with_what_makes_a_robot_of_them(client: TestClient) -> None:
    items = client.get("/v1/known-robots").json()["items"]
    assert [one["name"] for one in items] == list(library_names())
    for one in items:
        assert one["source"]
        made = client.post("/v1/robots", json={"name": one["name"], "description": one["description"]})
        assert made.status_code == 201
        names = robot_from_library(one["name"]).joint_names
        assert [joint["name"] for joint in made.json()["joints"]] == list(names)


def test_a_robot_may_float_and_stand_on_feet_of_unknown_force(client: TestClient) -> None:
    body = {"name": "walker", "description": {"format": "urdf", "content": WALKER}, "base": "floating"}
    answer = client.post("/v1/robots", json=body)
    assert answer.status_code == 201
    robot = answer.json()
    assert robot["base"] == "floating"
    assert [joint["name"] for joint in robot["joints"]] == [*BASE_JOINTS["floating"], "hip", "knee", "shoulder"]
    assert [limb["title"] for limb in robot["limbs"]] == ["all 3 joints", "hip to knee, 2 joints", "shoulder"]
    assert "M6" in robot["base_parameters"]["names"]
    assert client.get(answer.headers["location"]).json() == robot
    assert client.post("/v1/robots", json={**body, "contacts": ["shin"]}).status_code == 201
    refused = client.post("/v1/robots", json={**body, "contacts": ["foot"]})
    assert refused.status_code == 422
    assert "no link 'foot' that moves by itself" in refused.json()["errors"][0]["detail"]
    fixed = client.post("/v1/robots", json={**body, "base": "fixed"}).json()
    assert fixed["base"] == "fixed"
