from __future__ import annotations

from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient
from service_helpers import app_of

from dynident.errors import DynidentError
from dynident_service.problems import to_problem, to_problem_fields
from dynident_service.settings import Settings


def test_a_path_that_is_not_there_gives_a_problem(client: TestClient) -> None:
    answer = client.get("/v1/robot")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["status"] == 404


@pytest.mark.parametrize(
    ("parameter", "field"),
    [
        ("/recordings/1", "/measurement_ids/1"),
        ("/validation", "/validation_ids"),
        ("/effects/0/recordings", "/effects/0/recordings"),
        ("q3", "q3"),
        ("", ""),
    ],
)
def test_a_parameter_of_the_library_is_the_field_of_the_request(parameter: str, field: str) -> None:
    problem = to_problem(DynidentError("wrong", pointer=parameter))
    assert [error.pointer for error in problem.errors or ()] == [field]
    unchanged = to_problem(DynidentError("wrong", pointer=parameter), {})
    assert [error.pointer for error in unchanged.errors or ()] == [parameter]


def test_a_method_not_allowed_lists_all_that_are(client: TestClient) -> None:
    answer = client.put("/v1/robots")
    assert answer.status_code == 405
    assert answer.headers["allow"] == "GET, POST"
    assert client.post("/v1/robots/x").headers["allow"] == "DELETE, GET, PATCH"
    assert client.delete("/v1/jobs/x").headers["allow"] == "GET"


@pytest.mark.parametrize("content", [b"{", b"", b"[]", b"null", b'"x"', b"\xff\xfe", b"[" * 50_000, b'{"name": NaN}'])
def test_a_body_that_is_no_request_gives_a_problem_and_never_a_500(client: TestClient, content: bytes) -> None:
    for path in (
        "/v1/robots",
        "/v1/identifications",
        "/v1/designs",
        "/v1/simulations",
        "/v1/drive_gains",
        "/v1/current_models",
        "/v1/reports",
    ):
        answer = client.post(path, content=content, headers={"content-type": "application/json"})
        assert answer.status_code in (400, 422), (path, answer.text)
        assert answer.headers["content-type"] == "application/problem+json"


def test_a_body_without_its_content_type_is_asked_for_it(client: TestClient) -> None:
    answer = client.post("/v1/robots", content=b'{"name": "arm"}')
    assert answer.status_code == 422
    assert "content-type: application/json" in answer.json()["detail"]


def test_a_field_that_there_is_not_is_named(client: TestClient) -> None:
    answer = client.post("/v1/designs", json={"robot_id": "rob_x", "limit": {}})
    assert answer.json()["errors"] == [{"pointer": "/limit", "detail": "there is no field 'limit'"}]


def test_a_body_that_is_too_large_is_refused_by_its_stated_length(client: TestClient) -> None:
    answer = client.post("/v1/measurements", files={"file": b"x" * 4_000_000}, data={"metadata": "{}"})
    assert answer.status_code == 413
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_body_that_is_too_large_is_refused_without_a_stated_length(client: TestClient) -> None:
    def endless() -> Iterator[bytes]:
        yield b'--x\r\ncontent-disposition: form-data; name="file"; filename="f"\r\n\r\n'
        for _ in range(100):
            yield b"x" * 100_000

    answer = client.post(
        "/v1/measurements", content=endless(), headers={"content-type": "multipart/form-data; boundary=x"}
    )
    assert answer.status_code == 413
    assert answer.headers["content-type"] == "application/problem+json"
    assert "3000000" in answer.json()["detail"]


def test_a_query_that_does_not_fit_names_the_parameter(client: TestClient) -> None:
    answer = client.get("/v1/robots", params={"limit": 0})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "limit"


def test_something_unexpected_gives_no_stack_trace(settings: Settings) -> None:
    app = app_of(settings.model_copy(update={"data_dir": settings.data_dir / "unexpected"}))

    @app.get("/broken")
    def broken() -> None:
        raise RuntimeError("secret of the machine room")

    # Without entering the application's lifespan: this route needs nothing that it opens.
    answer = TestClient(app, "http://127.0.0.1", raise_server_exceptions=False).get("/broken")
    assert answer.status_code == 500
    assert answer.headers["content-type"] == "application/problem+json"
    assert "secret" not in answer.text
    assert "Traceback" not in answer.text


def test_pointers_pass_over_the_names_of_union_members_and_escape_what_they_must() -> None:
    body = {"a/b": {"preprocessing": {"cut": "x"}}}
    errors = [
        {"type": "float_parsing", "loc": ("body", "a/b", "preprocessing", "Preprocessing", "cut", "float"), "msg": "1"},
        {"type": "literal_error", "loc": ("body", "a/b", "preprocessing", "Preprocessing", "cut", "lit"), "msg": "2"},
        {"type": "missing", "loc": ("body", "a/b", "order"), "msg": "3"},
    ]
    fields = to_problem_fields(errors, body)
    assert [(field.pointer, field.detail) for field in fields] == [
        ("/a~1b/preprocessing/cut", "1; or 2"),
        ("/a~1b/order", "3"),
    ]


def test_health_readiness_and_metrics_are_answered(client: TestClient) -> None:
    assert client.get("/healthz").json()["status"] == "ok"
    ready = client.get("/readyz")
    assert ready.status_code == 200
    assert ready.json()["checks"]["database"] == "ok"
    client.get("/v1/robots/rob_nothing")
    metrics = client.get("/metrics").text
    assert 'route="/v1/robots/{robot_id}",status="404"' in metrics
    for name in ("dynident_jobs", "dynident_oldest_queued_job_seconds", "dynident_job_deaths", "dynident_free_disk"):
        assert name in metrics


def test_the_documentation_is_served(client: TestClient) -> None:
    assert client.get("/docs").status_code == 200
    assert client.get("/openapi.json").json()["info"]["title"] == "dynident"
