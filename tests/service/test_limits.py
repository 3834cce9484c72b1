"""How much, how fast and how many: a service that is leaned on stays small and says what is too much."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any
from urllib.parse import urlsplit

import anyio
import httpx2
import pytest
from fastapi.testclient import TestClient
from service_helpers import app_of, serving, wait_for

from dynident_service.request_limits import MOST_A_THREAD, MOST_VALUES, Admission, charge_key, mark_long
from dynident_service.settings import Settings

FORM = "multipart/form-data; boundary=x"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    """A service that allows little."""
    return Settings(
        data_dir=tmp_path_factory.mktemp("small"),
        workers=1,
        port=0,
        log_level="error",
        max_body_bytes=1_000_000,
        max_upload_bytes=3_000_000,
        max_connections=7,  # of which one address may have five
        header_timeout_seconds=0.4,
        body_timeout_seconds=0.4,
    )


@pytest.fixture(scope="module")
def address(small: Settings) -> Iterator[tuple[str, int]]:
    with serving(small) as url:
        parts = urlsplit(url)
        assert parts.hostname is not None
        assert parts.port is not None
        yield parts.hostname, parts.port


def raw(address: tuple[str, int], content: bytes, timeout: float = 20.0) -> bytes:
    """Send bytes and read until the other end closes."""
    with socket.create_connection(address, timeout=timeout) as connection:
        connection.sendall(content)
        answer = b""
        while part := connection.recv(65536):
            answer += part
        return answer


def beginning(length: int) -> bytes:
    """The beginning of a POST: all of its head, and nothing of its body."""
    head = f"POST /v1/robots HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: {length}"
    return head.encode() + b"\r\n\r\n"


@pytest.mark.parametrize("path", ["/v1/robots", "/v1/simulations"])
@pytest.mark.parametrize("kind", [FORM, "application/x-www-form-urlencoded", "text/csv"])
def test_no_content_type_lifts_the_limit_of_a_body(small: Settings, path: str, kind: str) -> None:
    with TestClient(app_of(small), "http://127.0.0.1", raise_server_exceptions=False) as client:
        for content in (b"x" * 2_000_000, iter([b"x" * 100_000] * 20)):
            answer = client.post(path, content=content, headers={"content-type": kind})
            assert answer.status_code == 413
            assert "DYNIDENT_MAX_BODY_BYTES" in answer.json()["detail"]


def test_only_the_upload_of_a_recording_may_be_large_and_only_as_a_form(small: Settings) -> None:
    with TestClient(app_of(small), "http://127.0.0.1", raise_server_exceptions=False) as client:
        form = client.post("/v1/measurements", files={"file": b"x" * 2_000_000}, data={"metadata": "{}"})
        assert form.status_code == 422
        plain = {"content-type": "application/x-www-form-urlencoded"}
        assert client.post("/v1/measurements", content=b"x" * 2_000_000, headers=plain).status_code == 413


def test_a_body_of_too_many_values_is_refused_before_it_is_parsed(client: TestClient) -> None:
    content = json.dumps({"name": [[]] * MOST_VALUES}).encode()
    answer = client.post("/v1/robots", content=content, headers={"content-type": "application/json"})
    assert answer.status_code == 413
    assert "values" in answer.json()["detail"]


def test_torque_is_predicted_along_as_many_rows_as_the_contract_names(client: TestClient) -> None:
    row = [0.0] * 6
    body = {"q": [row] * 100_000, "dq": [row] * 100_000, "ddq": [row] * 100_000, "t": [0.0] * 100_000}
    assert client.post("/v1/identifications/idn_none/predictions", json=body).status_code == 404


def test_a_trajectory_that_is_wrong_throughout_gets_a_short_answer(client: TestClient) -> None:
    body: dict[str, Any] = {"robot_id": "rob_x", "trajectory": {"t": [0, 1], "q": ["wrong"] * 300_000}}
    answer = client.post("/v1/simulations", json=body)
    assert answer.status_code == 422
    assert "/trajectory/q/0" in [field["pointer"] for field in answer.json()["errors"]]
    assert len(answer.content) < 20_000


def test_a_request_with_many_wrong_fields_names_the_first_hundred(client: TestClient) -> None:
    answer = client.post("/v1/robots", json={f"surprise{n}": 1 for n in range(5000)})
    assert answer.status_code == 422
    assert len(answer.json()["errors"]) == 100
    assert "more" in answer.json()["detail"]


def test_a_body_that_does_not_come_on_is_given_up(address: tuple[str, int]) -> None:
    began = time.monotonic()
    answer = raw(address, beginning(1000) + b'{"name":')
    assert answer.startswith(b"HTTP/1.1 408")
    assert b"application/problem+json" in answer
    assert time.monotonic() - began < 10


def test_a_body_that_only_trickles_is_given_up(address: tuple[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dynident_service.request_limits.FIRST_GRACE", 0.3)
    with socket.create_connection(address, timeout=20) as connection:
        connection.sendall(beginning(1000))
        answer = b""
        connection.settimeout(0.1)
        for _ in range(50):
            with suppress(TimeoutError):
                answer = connection.recv(65536)
                break
            connection.sendall(b" ")
        assert answer.startswith(b"HTTP/1.1 408")


@pytest.mark.parametrize("content", [b"", b"GET /healthz HT", b"GET /healthz HTTP/1.1\r\nhost: localhost\r\nx"])
def test_a_connection_that_asks_for_nothing_is_closed(address: tuple[str, int], content: bytes) -> None:
    assert raw(address, content) == b""


def test_a_connection_that_was_answered_and_asks_for_nothing_more_is_closed(address: tuple[str, int]) -> None:
    asked = b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n"
    answer = raw(address, asked + b"GET /healthz HT")
    assert answer.count(b"HTTP/1.1 200") == 1


def test_the_rest_of_a_request_that_was_answered_is_not_waited_for(address: tuple[str, int]) -> None:
    head = b"POST /v1/nothing HTTP/1.1\r\nhost: localhost\r\ncontent-length: 1000\r\n\r\n"
    with socket.create_connection(address, timeout=20) as connection:
        connection.sendall(head)
        assert connection.recv(12) == b"HTTP/1.1 404"

        def is_closed() -> bool:
            try:
                connection.sendall(b" ")
            except OSError:
                return True
            return False

        wait_for(is_closed, 10.0)


def test_one_connection_too_many_is_told_to_come_back(address: tuple[str, int]) -> None:
    def told() -> bytes:
        return raw(address, b"GET /healthz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n")

    wait_for(lambda: told().startswith(b"HTTP/1.1 200"))
    held = [socket.create_connection(address) for _ in range(5)]
    try:
        answer = raw(address, b"")
        assert answer.startswith(b"HTTP/1.1 503")
        assert b"retry-after: 1" in answer
        assert b"DYNIDENT_MAX_CONNECTIONS" in answer
    finally:
        for connection in held:
            connection.close()
    wait_for(lambda: told().startswith(b"HTTP/1.1 200"))


def test_more_requests_than_can_be_answered_are_told_to_come_back(tmp_path: Any) -> None:
    settings = Settings(data_dir=tmp_path, max_requests=3, max_followers=1)  # of three, one is another's
    go_on = threading.Event()
    inside: list[str] = []

    async def slow(scope: Any, receive: Any, send: Any) -> None:
        inside.append(scope["path"])
        if scope["path"] == "/v1/robots":
            mark_long(scope)  # and keeps no turn
        while not go_on.is_set():
            await anyio.sleep(0.01)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    async def ask() -> None:
        transport = httpx2.ASGITransport(Admission(slow, settings))
        async with (
            httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client,
            anyio.create_task_group() as group,
        ):
            for path in ("/v1/robots", "/v1/robots", "/v1/jobs/a/events"):
                group.start_soon(client.get, path)
            while len(inside) < 3:
                await anyio.sleep(0.01)
            for path in ("/v1/robots", "/v1/jobs/b/events"):
                refused = await client.get(path)
                assert refused.status_code == 429
                assert refused.headers["retry-after"] in ("1", "2", "3")
                assert refused.headers["content-type"] == "application/problem+json"
            group.start_soon(client.get, "/healthz")
            while len(inside) < 4:
                await anyio.sleep(0.01)
            go_on.set()
        assert inside[3] == "/healthz"

    anyio.run(ask)


def test_those_who_would_wait_long_for_a_short_answer_are_told_so_at_once(tmp_path: Any) -> None:
    settings = Settings(data_dir=tmp_path, request_threads=1)
    go_on = threading.Event()
    inside: list[str] = []
    arrived: list[str] = []

    async def slow(scope: Any, receive: Any, send: Any) -> None:
        if scope["path"] == "/v1/reports":
            mark_long(scope)
        inside.append(scope["path"])
        while not go_on.is_set():
            await anyio.sleep(0.01)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    admission = Admission(slow, settings)

    async def counted(scope: Any, receive: Any, send: Any) -> None:
        arrived.append(scope["path"])
        await admission(scope, receive, send)

    async def until(condition: Callable[[], bool]) -> None:
        while not condition():
            await anyio.sleep(0.01)

    async def ask() -> None:
        transport = httpx2.ASGITransport(counted)
        async with (
            httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client,
            anyio.create_task_group() as group,
        ):
            for _ in range(5):  # what is computed elsewhere, and large bodies, keep nobody out
                group.start_soon(client.get, "/v1/reports")
                group.start_soon(partial(client.post, "/v1/measurements", content=b"." * 200_000))
            await until(lambda: len(inside) == 10)
            share = 3 * MOST_A_THREAD // 4
            for _ in range(share):
                group.start_soon(client.get, "/v1/robots")
            await until(lambda: len(arrived) == 10 + share)
            refused = await client.get("/v1/robots")
            assert refused.status_code == 429
            assert "DYNIDENT_REQUEST_THREADS" in refused.json()["detail"]
            go_on.set()

    anyio.run(ask)


async def ask_directly(app: Any, path: str, method: str, body: bool, answered: list[str]) -> None:
    """Ask an application without a network; its path joins those that are answered when the answer begins."""

    async def receive() -> Any:
        if not body:
            await anyio.sleep_forever()
        return {"type": "http.request", "body": b"{}", "more_body": False}

    async def send(message: Any) -> None:
        if message["type"] == "http.response.start":
            answered.append(path)

    headers = {"POST": [(b"content-length", b"2")], "PUT": [(b"transfer-encoding", b"chunked")]}.get(method, [])
    await app({"type": "http", "path": path, "method": method, "headers": headers}, receive, send)


def test_of_many_short_requests_the_first_is_answered_first_and_nobody_waits_for_the_slow(tmp_path: Any) -> None:
    settings = Settings(data_dir=tmp_path, request_threads=1)
    inside: list[str] = []
    most = 0

    async def app(scope: Any, receive: Any, send: Any) -> None:
        nonlocal most
        if scope["method"] != "GET":
            await receive()
        inside.append(scope["path"])
        most = max(most, len(inside))
        await anyio.sleep(0.005)
        inside.remove(scope["path"])
        await send({"type": "http.response.start", "status": 200, "headers": []})
        if scope["path"] == "/read-slowly":
            await anyio.sleep_forever()
        await send({"type": "http.response.body", "body": b""})

    admission = Admission(app, settings)
    answered: list[str] = []

    async def ask(path: str, method: str = "GET", body: bool = True) -> None:
        await ask_directly(admission, path, method, body, answered)

    async def together() -> None:
        async with anyio.create_task_group() as group:
            for method in ("POST", "PUT"):
                group.start_soon(ask, "/sent-slowly", method, False)
            group.start_soon(ask, "/read-slowly")
            await anyio.sleep(0.02)
            for number in range(5):
                group.start_soon(ask, f"/{number}", ("GET", "POST")[number % 2])
            with anyio.fail_after(10):
                while len(answered) < 6:
                    await anyio.sleep(0.01)
            group.cancel_scope.cancel()
        with anyio.fail_after(10):  # and who has left is not waited for
            await ask("/last")

    anyio.run(together)
    assert answered == ["/read-slowly", *(f"/{number}" for number in range(5)), "/last"]
    assert most == 1


def test_those_who_follow_a_job_are_behind_those_who_came_before_them(tmp_path: Any) -> None:
    began: list[str] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        began.append(scope["path"])
        await anyio.sleep(0.005)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        if scope["path"].endswith("/events"):
            await anyio.sleep_forever()  # once it is answered it keeps nobody waiting

    admission = Admission(app, Settings(data_dir=tmp_path))

    async def nothing(*_: Any) -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def together() -> None:
        paths = [f"/{n}" for n in range(8)] + ["/v1/jobs/a/events", "/v1/jobs/b/events"] + [f"/{n}" for n in range(8)]
        async with anyio.create_task_group() as group:
            for path in paths:
                group.start_soon(
                    admission, {"type": "http", "path": path, "method": "GET", "headers": []}, nothing, nothing
                )
            with anyio.fail_after(10):
                while len(began) < len(paths):
                    await anyio.sleep(0.01)
            group.cancel_scope.cancel()
        assert began == paths

    anyio.run(together)


def test_who_reads_nothing_keeps_no_place_among_the_short_and_leaves_places_to_another(tmp_path: Any) -> None:
    settings = Settings(data_dir=tmp_path, max_requests=20, request_threads=1)
    begun: Counter[str] = Counter()
    refused: Counter[str] = Counter()

    async def app(scope: Any, receive: Any, send: Any) -> None:
        begun[scope["party"]] += 1
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await anyio.sleep_forever()

    admission = Admission(app, settings, party_of=lambda scope: scope["party"])

    async def ask(party: str) -> None:
        async def receive() -> Any:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message: Any) -> None:
            refused[party] += message.get("status") == 429

        scope = {"type": "http", "path": "/v1/robots", "method": "GET", "headers": [], "party": party}
        await admission(scope, receive, send)

    async def together() -> None:
        async with anyio.create_task_group() as group:
            for party in ["greedy"] * 20 + ["other"]:
                group.start_soon(ask, party)
                await anyio.sleep(0.001)
            with anyio.fail_after(10):
                while not begun["other"]:
                    await anyio.sleep(0.01)
            group.cancel_scope.cancel()

    anyio.run(together)
    assert begun == {"greedy": 15, "other": 1}  # more than the eight that may wait to be answered
    assert refused["greedy"] == 5
    assert not refused["other"]


def test_what_a_key_sends_takes_no_place_of_its_address_once_the_key_is_known(tmp_path: Any) -> None:
    begun = 0

    async def app(scope: Any, receive: Any, send: Any) -> None:
        nonlocal begun
        begun += 1
        charge_key(scope, "cell")
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await anyio.sleep_forever()

    admission = Admission(app, Settings(data_dir=tmp_path, max_requests=4))  # of which one party may have three

    async def nothing(*_: Any) -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def together() -> None:
        async with anyio.create_task_group() as group:
            for _ in range(4):
                scope = {"type": "http", "path": "/", "method": "GET", "headers": [], "client": ("192.0.2.1", 1)}
                group.start_soon(admission, scope, nothing, nothing)
                await anyio.sleep(0.01)
            assert begun == 4
            group.cancel_scope.cancel()

    anyio.run(together)
