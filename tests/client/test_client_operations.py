from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest
from support.openapi_contract import COLLECTIONS, CONTRACT, OPERATIONS, operation_of

from dynident_client import Client, JobCancelled, JobFailed, ProblemError

ANSWER = {"id": "x1", "job_id": "job_1", "status": "queued", "items": [], "cursor": None, "state": "queued"}
STREAM = {"content-type": "text/event-stream"}


class Recorder:
    """Takes requests and answers them all alike."""

    def __init__(self) -> None:
        self.requests: list[httpx2.Request] = []

    def __call__(self, request: httpx2.Request) -> httpx2.Response:
        request.read()
        self.requests.append(request)
        if request.url.path.endswith(("/events", "/estimates")):
            return httpx2.Response(200, headers=STREAM, text='event: state\ndata: {"state": "succeeded"}\nid: 1\n\n')
        return httpx2.Response(200, json=ANSWER)


def calls(file: Path) -> list[Callable[[Client], Any]]:
    """One call of every method of the client that reaches the service."""
    made: list[Callable[[Client], Any]] = [
        lambda c: c.health(),
        lambda c: c.readiness(),
        lambda c: c.metrics(),
        lambda c: c.effects(),
        lambda c: c.known_robots(),
        lambda c: c.usage(),
        lambda c: c.robots.create("a", urdf="<robot/>"),
        lambda c: list(c.robots.bundle("x1")),
        lambda c: c.robots.geometry("x1"),
        lambda c: c.robots.poses("x1", [[0.1, 0.2]]),
        lambda c: c.robots.put_meshes("x1", {"one.stl": file}),
        lambda c: c.measurements.standstills("x1"),
        lambda c: c.measurements.begin("r1", "a"),
        lambda c: c.measurements.append_rows("x1", {"t": [0.0]}, offset=0),
        lambda c: list(c.measurements.follow("x1", design="d1")),
        lambda c: c.imports.upload("r1", file),
        lambda c: c.imports.upload("r1", [file, file]),
        lambda c: c.measurements.upload("r1", file),
        lambda c: list(c.measurements.content("x1")),
        lambda c: c.measurements.raw("x1", ["q1"], points=100),
        lambda c: c.robots.label("x1", name="a"),
        lambda c: c.measurements.label("x1", tags=["a"]),
        lambda c: c.identifications.label("x1", archived=True),
        lambda c: c.measurements.revise("x1", signs={"tau2": -1}),
        lambda c: c.designs.create("r1"),
        lambda c: c.designs.trajectory("x1"),
        lambda c: c.designs.clearances("x1"),
        lambda c: c.simulations.create("r1", design="d1"),
        lambda c: c.identifications.create("r1", ["m1"]),
        lambda c: c.identifications.create_many([{"robot_id": "r1", "measurement_ids": ["m1"]}]),
        lambda c: c.identifications.batch("x1"),
        lambda c: c.identifications.cancel_batch("x1"),
        lambda c: c.identifications.forget_batch("x1"),
        lambda c: c.identifications.extend("x1", ["offset"]),
        lambda c: c.identifications.remove("x1", [{"effect": "offset", "joints": ["elbow"]}]),
        lambda c: c.identifications.essential("x1", ratio=12.0),
        lambda c: c.identifications.correlation("x1"),
        lambda c: c.identifications.lineage("x1"),
        lambda c: c.identifications.compare_lineages("x1", "x2"),
        lambda c: c.identifications.export("x1"),
        lambda c: c.identifications.list_exports("x1"),
        lambda c: c.identifications.export_with_error("x1", "urdf"),
        lambda c: c.identifications.predict("x1", [[0.0]], [[0.0]], [[0.0]]),
        lambda c: c.identifications.verdict("x1"),
        lambda c: c.identifications.tables("x1"),
        lambda c: c.comparisons.create("i1", "m1"),
        lambda c: c.comparisons.series("x1", "elbow", start=1.0, end=2.0),
        lambda c: c.comparisons.residual_map("x1", "elbow", "q_elbow"),
        lambda c: c.comparisons.spectrum("x1", "elbow", "angle"),
        lambda c: c.comparisons.autocorrelation("x1", "elbow", longest=2.0),
        lambda c: c.diagnoses.create("i1"),
        lambda c: c.diagnoses.evidence("x1", 1, "elbow"),
        lambda c: c.diagnoses.why_not("x1", "backlash", "elbow"),
        lambda c: c.diagnoses.detection_limits("x1"),
        lambda c: c.next_experiments.create("x1"),
        lambda c: c.campaigns.create("r1"),
        lambda c: c.campaigns.ask("x1"),
        lambda c: c.campaigns.tell("x1", "m1"),
        lambda c: c.series.create("i1", [["m1"], ["m2"]]),
        lambda c: c.series.figure("x1"),
        lambda c: c.validations.create("i1", "cross"),
        lambda c: c.drive_gains.create("r1", ["m1"], ["m2"], mass=2.0, weigh=["m3"]),
        lambda c: c.current_models.create("r1", ["m1"], validation=["m2"]),
        lambda c: c.reports.create("i1"),
        lambda c: c.reports.content("x1"),
        lambda c: c.jobs.page(),
        lambda c: c.jobs.get("x1"),
        lambda c: c.jobs.cancel("x1"),
        lambda c: list(c.jobs.events("x1")),
    ]
    for name in COLLECTIONS:
        made += [
            lambda c, name=name: getattr(c, name).get("x1"),
            lambda c, name=name: list(getattr(c, name).all()),
            lambda c, name=name: getattr(c, name).delete("x1"),
        ]
    return made


def test_every_operation_of_the_contract_has_a_client_method(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_text("t,q1\n0,0\n")
    recorder = Recorder()
    with Client("http://x", transport=httpx2.MockTransport(recorder)) as client:
        for call in calls(file):
            call(client)
    reached = {operation_of(request) for request in recorder.requests}
    assert OPERATIONS - reached == set()


def test_what_the_client_sends_has_the_fields_of_the_contract(tmp_path: Path) -> None:
    recorder = Recorder()
    file = tmp_path / "run.csv"
    file.write_text("t,q1\n0,0\n")
    with Client("http://x", transport=httpx2.MockTransport(recorder)) as client:
        for call in calls(file):
            call(client)
    checked = 0
    for request in recorder.requests:
        if request.method != "POST" or "json" not in request.headers.get("content-type", ""):
            continue
        for template, operations in CONTRACT["paths"].items():
            if operations.get("post", {}).get("operationId") == operation_of(request):
                schema = operations["post"]["requestBody"]["content"]["application/json"]["schema"]
                model = CONTRACT["components"]["schemas"].get(schema.get("$ref", "").rpartition("/")[2], schema)
                sent = json.loads(request.content)
                assert set(sent) <= set(model["properties"]), template
                assert set(model.get("required", ())) <= set(sent), template
                checked += 1
    assert checked >= 9


def test_resources_may_stand_for_their_identifiers_in_every_field() -> None:
    recorder = Recorder()
    client = Client("http://robots.example", transport=httpx2.MockTransport(recorder))
    run = client.measurements.get("x1")
    client.designs.create("rob_1", earlier_ids=[run], limits={"joint1": {"velocity": 1.0}})
    sent = json.loads(recorder.requests[-1].content)
    assert sent["earlier_ids"] == ["x1"]
    assert sent["limits"] == {"joint1": {"velocity": 1.0}}


def test_a_batch_gives_its_identifications_in_the_order_asked_and_they_can_be_waited_for() -> None:
    items = [{"id": one, "job_id": f"job_{one}", "status": "queued"} for one in ("idn_2", "idn_1")]
    sent: list[Any] = []

    def answer(request: httpx2.Request) -> httpx2.Response:
        if request.url.path.endswith(("/events", "/estimates")):
            return httpx2.Response(200, headers=STREAM, text="")
        if request.method == "POST":
            sent.append(json.loads(request.content))
            return httpx2.Response(202, json={"id": "bat_1", "states": {"queued": 2}, "items": items})
        return httpx2.Response(200, json={**ANSWER, "status": "succeeded", "result": {"of": request.url.path}})

    with Client("http://x", transport=httpx2.MockTransport(answer)) as client:
        run = client.measurements.get("x1")
        batch = client.identifications.create_many([{"robot_id": "rob_1", "measurement_ids": [run]}] * 2)
        assert batch.states == {"queued": 2}
        assert [one.id for one in batch.identifications] == ["idn_2", "idn_1"]
        assert batch.identifications[1].wait().result == {"of": "/v1/identifications/idn_1"}
    assert sent[0]["items"][0] == {"robot_id": "rob_1", "measurement_ids": ["x1"]}


def test_a_lost_answer_is_asked_for_again_with_the_same_key() -> None:
    keys: list[str] = []

    def answer(request: httpx2.Request) -> httpx2.Response:
        keys.append(request.headers["idempotency-key"])
        if len(keys) == 1:
            raise httpx2.ReadError("the connection was lost", request=request)
        return httpx2.Response(201, json=ANSWER)

    with Client("http://x", transport=httpx2.MockTransport(answer)) as client:
        client.robots.create("a", urdf="<robot/>")
        client.robots.create("a", urdf="<robot/>")
    assert keys[0] == keys[1]
    assert keys[1] != keys[2]


def test_a_busy_service_is_asked_again_when_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    waited: list[float] = []
    monkeypatch.setattr("dynident_client.transport.time.sleep", waited.append)

    def answer(request: httpx2.Request) -> httpx2.Response:
        asked.append(request.headers["idempotency-key"])
        busy = httpx2.Response(429, json={"title": "Too busy"}, headers={"Retry-After": "2"})
        return busy if len(asked) < 8 else httpx2.Response(201, json=ANSWER)

    with Client("http://x", transport=httpx2.MockTransport(answer)) as client:
        client.robots.create("a", urdf="<robot/>")
        assert (len(set(asked)), waited) == (1, [2.0] * 7)
        asked.clear()
        monkeypatch.setattr("dynident_client.transport.PATIENCE", 1.0)
        with pytest.raises(ProblemError) as refused:
            client.robots.create("a", urdf="<robot/>")
    assert refused.value.status == 429


def test_waiting_goes_on_after_a_lost_connection_where_it_was() -> None:
    resumed: list[str] = []
    done = {**ANSWER, "status": "succeeded", "result": {"verdict": "adequate"}}

    def answer(request: httpx2.Request) -> httpx2.Response:
        if not request.url.path.endswith(("/events", "/estimates")):
            return httpx2.Response(200, json=ANSWER if request.method == "POST" else done)
        resumed.append(request.headers.get("last-event-id", ""))
        if len(resumed) == 1:

            def broken() -> Any:
                yield b'event: progress\ndata: {"fraction": 0.5, "message": "half"}\nid: 7\n\n'
                raise httpx2.ReadError("the connection was lost", request=request)

            return httpx2.Response(200, headers=STREAM, content=broken())
        return httpx2.Response(
            200, headers=STREAM, text='event: progress\ndata: {"fraction": 1.0, "message": "done"}\nid: 8\n\n'
        )

    told: list[float] = []
    with Client("http://x", transport=httpx2.MockTransport(answer)) as client:
        found = client.diagnoses.create("i1").wait(lambda fraction, message: told.append(fraction))
    assert found.result == {"verdict": "adequate"}
    assert resumed == ["", "7"]
    assert told == [0.5, 1.0]


@pytest.mark.parametrize(
    ("status", "error", "expected"),
    [
        ("failed", {"status": 422, "title": "Too few samples", "detail": "…"}, JobFailed),
        ("cancelled", None, JobCancelled),
    ],
)
def test_a_job_that_ends_badly_raises(status: str, error: dict[str, Any] | None, expected: type[Exception]) -> None:
    def answer(request: httpx2.Request) -> httpx2.Response:
        if request.url.path.endswith(("/events", "/estimates")):
            return httpx2.Response(200, headers=STREAM, text="")
        return httpx2.Response(200, json={**ANSWER, "status": status, "error": error})

    with Client("http://x", transport=httpx2.MockTransport(answer)) as client, pytest.raises(expected):
        client.reports.create("i1").wait()


def test_a_problem_is_raised_with_its_fields() -> None:
    problem = {"type": "x", "title": "Gap", "status": 422, "detail": "…", "errors": [{"pointer": "q3", "detail": "…"}]}

    def answer(request: httpx2.Request) -> httpx2.Response:
        return httpx2.Response(422, json=problem, headers={"content-type": "application/problem+json"})

    with Client("http://x", transport=httpx2.MockTransport(answer)) as client, pytest.raises(ProblemError) as caught:
        client.robots.create("a", urdf="<robot/>")
    assert caught.value.status == 422
    assert caught.value.errors[0]["pointer"] == "q3"


def test_lists_are_gone_through_page_by_page() -> None:
    def answer(request: httpx2.Request) -> httpx2.Response:
        second = request.url.params.get("cursor") == "c"
        items = [{"id": "r3"}] if second else [{"id": "r1"}, {"id": "r2"}]
        return httpx2.Response(200, json={"items": items, "cursor": None if second else "c"})

    with Client("http://x", transport=httpx2.MockTransport(answer)) as client:
        assert [robot.id for robot in client.robots.all()] == ["r1", "r2", "r3"]


def test_importing_the_client_loads_no_science_and_no_service() -> None:
    code = (
        "import sys, dynident_client;"
        "heavy = {'numpy', 'scipy', 'casadi', 'pinocchio', 'pyarrow', 'pydantic', 'fastapi', 'sqlalchemy', 'dynident'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
