"""What is told of requests and jobs by spans, where that is wished."""

from __future__ import annotations

import http.server
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, app_of, wait_for

pytest.importorskip("opentelemetry.sdk", reason="the extra [otel] is not installed")
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from dynident_service import tracing
from dynident_service.app import create_app
from dynident_service.jobs.task_input_output import Call, answer_call
from dynident_service.settings import Settings
from dynident_service.storage.repository_values import NewJob
from dynident_service.storage_and_engine import Services

TRACE, PARENT = "4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7"
HEADERS = {"traceparent": f"00-{TRACE}-{PARENT}-01", "x-request-id": "run-12", "authorization": "Bearer secret"}


@pytest.fixture
def spans(monkeypatch: pytest.MonkeyPatch) -> InMemorySpanExporter:
    """Spans of this process, in the order in which they ended."""
    exporter, begin = InMemorySpanExporter(), tracing.begin_tracing
    monkeypatch.setattr(tracing, "begin_tracing", lambda: begin(exporter))
    return exporter


@pytest.fixture
def traced(tmp_path: Path, spans: InMemorySpanExporter) -> Iterator[TestClient]:
    with TestClient(app_of(Settings(data_dir=tmp_path, workers=1, traces=True)), "http://127.0.0.1") as client:
        yield client


def named(spans: InMemorySpanExporter, name: str) -> ReadableSpan:
    (found,) = (one for one in spans.get_finished_spans() if one.name == name)
    return found


def test_a_request_is_a_span_of_its_callers_trace_with_the_id_of_the_log(
    traced: TestClient, spans: InMemorySpanExporter
) -> None:
    assert traced.get("/v1/robots/rob_1?key=hidden", headers=HEADERS).status_code == 404
    traced.get("/healthz")
    (span,) = spans.get_finished_spans()
    assert span.name == "GET /v1/robots/{robot_id}"
    assert (format(span.context.trace_id, "032x"), format(span.parent.span_id, "016x")) == (TRACE, PARENT)
    told = dict(span.attributes or {})
    assert told["dynident.request_id"] == "run-12"
    assert (told["http.response.status_code"], told["http.route"]) == (404, "/v1/robots/{robot_id}")
    assert not any("hidden" in str(value) or "secret" in str(value) for value in told.values())


def test_what_a_request_has_computed_elsewhere_belongs_to_its_trace(spans: InMemorySpanExporter) -> None:
    tracing.begin_tracing()
    try:
        with tracing.trace_task("request", HEADERS["traceparent"]):
            call = Call("operator:add", {})
        answer_call(call, 0)
    finally:
        tracing.end_tracing()
    request, computed = named(spans, "request"), named(spans, "compute operator:add")
    assert computed.parent is not None
    assert computed.parent.span_id == request.context.span_id
    assert format(computed.context.trace_id, "032x") == TRACE


class Collector:
    """Takes spans as OTLP sends them over HTTP."""

    def __init__(self) -> None:
        self.spans: list[Any] = []
        collector = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                sent = ExportTraceServiceRequest()
                sent.ParseFromString(self.rfile.read(int(self.headers["content-length"])))
                for resource in sent.resource_spans:
                    collector.spans += [span for scope in resource.scope_spans for span in scope.spans]
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_: Any) -> None:
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


def test_the_process_that_computes_a_job_goes_on_with_the_trace_of_its_request(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    collector = Collector()
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", f"http://127.0.0.1:{collector.server.server_port}")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_COMPRESSION", "none")
    monkeypatch.setenv("DYNIDENT_TRACES", "true")
    with TestClient(create_app(Settings(data_dir=tmp_path, workers=1)), "http://127.0.0.1") as client:
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        described = {"name": "arm", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
        robot = client.post("/v1/robots", json=described).json()
        asked = {"robot_id": robot["id"], "effects": [], "trajectory": {"duration": 2.0, "sampling_rate": 100.0}}
        made = client.post("/v1/simulations", json=asked, headers=HEADERS).json()
        wait_for(lambda: services.job_queue.get(made["job_id"]).finished_at, 60.0)
        wait_for(lambda: {one.name.partition(" ")[0] for one in collector.spans} >= {"job", "POST"}, 20.0)
    collector.server.shutdown()
    (request,) = (one for one in collector.spans if one.name == "POST /v1/simulations")
    (job,) = (one for one in collector.spans if one.name.startswith("job "))
    assert job.trace_id.hex() == request.trace_id.hex() == TRACE
    assert job.parent_span_id == request.span_id
    told = {one.key: one.value.string_value or one.value.int_value for one in job.attributes}
    assert told["dynident.job_id"] == made["job_id"]
    assert (told["dynident.request_id"], told["dynident.attempt"]) == ("run-12", 1)


def test_nothing_is_traced_or_stored_with_a_job_unless_that_is_asked_for(tmp_path: Path) -> None:
    with TestClient(app_of(Settings(data_dir=tmp_path, workers=1)), "http://127.0.0.1") as client:
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        services.engine.drain()
        services.job_queue.enqueue(NewJob("report", "small_jobs:answer"))
        assert tracing.get_current_span() is None
        assert [claim.trace for claim in services.job_queue.claim(1)] == [None]
    code = "import sys, dynident_service.app; sys.exit('opentelemetry.sdk' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
