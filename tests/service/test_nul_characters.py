"""U+0000, which PostgreSQL's texts cannot hold, wherever a text reaches the database."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, app_of

from dynident_service.settings import Settings

LISTS = ("robots", "measurements", "designs", "identifications", "comparisons", "diagnoses", "validations", "jobs")


@pytest.fixture(scope="module", params=["sqlite", pytest.param("postgresql", marks=pytest.mark.slow)])
def either(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    url = request.getfixturevalue("postgresql") if request.param == "postgresql" else ""
    settings = Settings(data_dir=tmp_path_factory.mktemp("nul"), database_url=url, workers=1)
    with TestClient(app_of(settings), "http://127.0.0.1", raise_server_exceptions=False) as client:
        yield client


@pytest.mark.parametrize("kind", LISTS)
def test_in_an_address_or_a_cursor(either: TestClient, kind: str) -> None:
    for path in (f"/v1/{kind}/a%00b", f"/v1/{kind}?cursor=a%00b"):
        answer = either.get(path)
        assert answer.status_code == 422, answer.text
        assert "U+0000" in answer.json()["detail"]
    assert either.get("/v1/identifications?robot_id=%00").status_code in (200, 422)


@pytest.mark.parametrize(
    ("path", "method"),
    [
        ("/v1/jobs/%00/cancel", "POST"),
        ("/v1/jobs/%00/events", "GET"),
        ("/v1/robots/%00", "DELETE"),
        ("/v1/measurements/%00/content", "GET"),
        ("/v1/identifications/%00/lineage", "GET"),
    ],
)
def test_in_an_address_of_a_part(either: TestClient, path: str, method: str) -> None:
    assert either.request(method, path).status_code == 422


def test_in_a_name_an_id_or_a_description(either: TestClient) -> None:
    dh = {"format": "modified_dh", "content": TWO_JOINTS}
    assert either.post("/v1/robots", json={"name": "a\0b", "description": dh}).status_code == 422
    assert either.post("/v1/designs", json={"robot_id": "a\0b"}).status_code == 422
    body = {"robot_id": "a\0b", "measurement_ids": ["\0"]}
    assert either.post("/v1/identifications", json=body).status_code == 422
    joints = [{**joint, "name": f"{joint['name']}\0"} for joint in TWO_JOINTS["joints"]]
    answer = either.post("/v1/robots", json={"name": "a", "description": {**dh, "content": {"joints": joints}}})
    assert answer.status_code < 500
    files = {"file": b"t,q1\n"}
    assert either.post("/v1/measurements", files=files, data={"metadata": '{"robot_id": "\\u0000"}'}).status_code == 422
