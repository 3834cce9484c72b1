"""Robots, measurements and identifications can be renamed, tagged and put away."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import wait_for
from support.measurement_uploads import as_csv, sound, upload

from dynident_service.storage.database import Database, migrate
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import NewResource
from dynident_service.storage.resource_repository import Resources


def paths(client: TestClient, robot: dict[str, Any]) -> list[str]:
    measurement = upload(client, robot, as_csv(sound())).json()
    body = {"robot_id": robot["id"], "measurement_ids": [measurement["id"]], "name": "first"}
    model = client.post("/v1/identifications", json=body).json()
    return [f"robots/{robot['id']}", f"measurements/{measurement['id']}", f"identifications/{model['id']}"]


def test_names_tags_and_archive_are_changed_apart(client: TestClient, robot: dict[str, Any]) -> None:
    for path in paths(client, robot):
        before = client.get(f"/v1/{path}").json()
        assert (before["tags"], before["archived"]) == ([], False)
        named = client.patch(f"/v1/{path}", json={"name": "arm of Monday"})
        assert named.status_code == 200, named.text
        assert named.json()["name"] == "arm of Monday"
        tagged = client.patch(f"/v1/{path}", json={"tags": ["lab 2", "cold", "cold"]}).json()
        assert (tagged["name"], tagged["tags"]) == ("arm of Monday", ["lab 2", "cold"])
        assert client.patch(f"/v1/{path}", json={"tags": []}).json()["tags"] == []
        # A job that ends in between would make a difference of its own.
        wait_for(lambda path=path: client.get(f"/v1/{path}").json().get("status") not in ("queued", "running"))
        unchanged = client.patch(f"/v1/{path}", json={}).json()
        assert unchanged == client.get(f"/v1/{path}").json()
        assert unchanged["request"] == before["request"]


def test_lists_leave_out_what_is_archived_unless_asked(client: TestClient, robot: dict[str, Any]) -> None:
    for path in paths(client, robot):
        kind, identifier = path.split("/")
        assert client.patch(f"/v1/{path}", json={"archived": True}).json()["archived"] is True

        def listed(query: str, kind: str = kind) -> set[str]:
            return {one["id"] for one in client.get(f"/v1/{kind}?limit=500{query}").json()["items"]}

        assert identifier not in listed("")
        assert identifier in listed("&archived=true")
        assert client.get(f"/v1/{path}").status_code == 200
        client.patch(f"/v1/{path}", json={"archived": False})
        assert identifier in listed("")


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({"name": ""}, "/name"),
        ({"tags": [""]}, "/tags/0"),
        ({"tags": "cold"}, "/tags"),
        ({"archived": "perhaps"}, "/archived"),
        ({"colour": "red"}, "/colour"),
    ],
)
def test_labels_that_cannot_be_are_named(
    client: TestClient, robot: dict[str, Any], body: dict[str, Any], pointer: str
) -> None:
    answer = client.patch(f"/v1/robots/{robot['id']}", json=body)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == pointer


def test_what_is_not_there_has_no_labels(client: TestClient, robot: dict[str, Any]) -> None:
    assert client.patch("/v1/robots/rob_none", json={"name": "x"}).status_code == 404
    assert client.patch(f"/v1/measurements/{robot['id']}", json={"name": "x"}).status_code == 404
    assert client.patch(f"/v1/robots/{robot['id']}", json={"tags": ["a\0b"]}).status_code == 422


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Any) -> str:
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'labels.sqlite3'}"
    return str(request.getfixturevalue("postgresql"))


def test_labels_are_stored_on_either_database(url: str, tmp_path: Any) -> None:
    database = Database(url)
    try:
        migrate(database)
        stored = Resources(database, ObjectStore(f"file://{tmp_path}/objects", tmp_path / "cache"))
        made = stored.create(NewResource("robot", {}, name="arm"))
        assert (made.tags, made.archived) == ((), False)
        labelled = stored.update_labels("robot", made.id, name="leg", tags=["a", "b"], archived=True)
        assert (labelled.name, labelled.tags, labelled.archived) == ("leg", ("a", "b"), True)
        assert made.id not in {one.id for one in stored.list_page("robot", 500, archived=False).items}
        assert made.id in {one.id for one in stored.list_page("robot", 500).items}
    finally:
        database.close()


def test_parts_of_a_robot_are_stated_with_it_and_later(client: TestClient, robot: dict[str, Any]) -> None:
    path = f"/v1/robots/{robot['id']}"
    assert (robot["has"], robot["has_not"]) == ([], [])
    answered = client.patch(path, json={"has_not": ["gravity_compensator", "cable"]}).json()
    assert answered["has_not"] == ["gravity_compensator", "cable"]
    # The later answer counts.
    changed = client.patch(path, json={"has": ["cable"]}).json()
    assert (changed["has"], changed["has_not"]) == (["cable"], ["gravity_compensator"])
    assert client.get(path).json() == changed
    refused = client.patch(path, json={"has": ["balancer"]})
    assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "/has/0")
    body = {**robot["request"], "has": ["spring"]}
    assert client.post("/v1/robots", json=body).json()["has"] == ["spring"]


def test_a_recommended_effect_is_posted_with_its_question(client: TestClient) -> None:
    from dynident_service.diagnoses.wire_types import RecommendedEffect
    from dynident_service.shared.wire_types import EffectChoice

    recommended = RecommendedEffect(effect="joint_spring", joints=["elbow"], question="Does the robot have one?")
    posted = EffectChoice.model_validate(recommended.model_dump())
    assert posted == EffectChoice(effect="joint_spring", joints=["elbow"])
