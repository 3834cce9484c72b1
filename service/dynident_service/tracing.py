"""Log lines as text or JSON, with request and job ids; optional OpenTelemetry tracing of requests and jobs.

Without it nothing of OpenTelemetry is imported. The standard `OTEL_…` variables say where spans go and how many.
"""

from __future__ import annotations

import importlib
import json
import logging
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal

from starlette.types import ASGIApp, Message, Receive, Scope, Send

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import SpanExporter


PARENT = "traceparent"
"""Header of W3C Trace Context that names the parent span."""
SOON = "1000"
"""Milliseconds until a span is sent; short, as a computing process may be killed."""
NOT_TRACED = frozenset({"/healthz", "/readyz", "/metrics"})
PACKAGES = ("opentelemetry.sdk.trace", "opentelemetry.exporter.otlp.proto.http")
_provider: TracerProvider | None = None
log = logging.getLogger("dynident.service")


def check_packages() -> None:
    """Raise ImportError if the packages for tracing are missing."""
    for package in PACKAGES:
        importlib.import_module(package)


def begin_tracing(exporter: SpanExporter | None = None) -> None:
    """Trace this process from now on; call it after a fork, as a thread sends the spans."""
    global _provider
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor, SimpleSpanProcessor

    # Only where the user has not said otherwise.
    os.environ.setdefault("OTEL_SERVICE_NAME", "dynident")
    os.environ.setdefault("OTEL_BSP_SCHEDULE_DELAY", SOON)
    _provider = TracerProvider()
    if exporter is not None:
        _provider.add_span_processor(SimpleSpanProcessor(exporter))
    elif (chosen := _create_exporter()) is not None:
        _provider.add_span_processor(BatchSpanProcessor(chosen))


def end_tracing() -> None:
    """Send the remaining spans, and stop tracing."""
    global _provider
    if _provider is not None:
        _provider.shutdown()
        _provider = None


def get_current_span() -> str | None:
    """Return the header that names the current span, for work that continues elsewhere."""
    if _provider is None:
        return None
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    carrier: dict[str, str] = {}
    TraceContextTextMapPropagator().inject(carrier)
    return carrier.get(PARENT)


@contextmanager
def trace_task(name: str, parent: str | None, **attributes: str | int) -> Iterator[None]:
    """Open a span for work that another process requested."""
    with _open_span(name, "CONSUMER", {} if parent is None else {PARENT: parent}, attributes):
        yield


class RequestTracing:
    """Middleware with a span for each request, a child of the caller's span; without query and headers."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Trace one request."""
        if scope["type"] != "http" or scope["path"] in NOT_TRACED or _provider is None:
            return await self._app(scope, receive, send)
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        method = scope["method"]
        attributes = {
            "http.request.method": method,
            "url.path": scope["path"],
            "url.scheme": scope.get("scheme", "http"),
        }
        with _open_span(method, "SERVER", headers, attributes) as span:

            async def send_with_status(message: Message) -> None:
                if message["type"] == "http.response.start":
                    span.set_attribute("http.response.status_code", message["status"])
                    if message["status"] >= 500:
                        _mark_failed(span)
                await send(message)

            try:
                return await self._app(scope, receive, send_with_status)
            finally:
                # The route is known only after the request was answered: until then the span has the method as its
                # name.
                route = getattr(scope.get("route"), "path", None)
                if route is not None:
                    span.update_name(f"{method} {route}")
                    span.set_attribute("http.route", route)


@contextmanager
def _open_span(name: str, kind: str, carrier: Mapping[str, str], attributes: Mapping[str, str | int]) -> Iterator[Any]:
    if _provider is None:
        yield None
        return
    from opentelemetry.trace import SpanKind
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    ids = {"dynident.request_id": get_current_request(), "dynident.job_id": get_current_job()}
    known = {**attributes, **{key: value for key, value in ids.items() if value is not None}}
    parent = TraceContextTextMapPropagator().extract(carrier)
    tracer = _provider.get_tracer("dynident")
    with tracer.start_as_current_span(name, parent, SpanKind[kind], known) as span:
        yield span


def _mark_failed(span: Any) -> None:
    from opentelemetry.trace import StatusCode

    span.set_status(StatusCode.ERROR)


def _create_exporter() -> SpanExporter | None:
    exporter_name = os.environ.get("OTEL_TRACES_EXPORTER", "otlp").strip().lower()
    if exporter_name == "otlp":
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter

        return OTLPSpanExporter()
    if exporter_name == "console":
        from opentelemetry.sdk.trace.export import ConsoleSpanExporter

        return ConsoleSpanExporter()
    if exporter_name != "none":
        log.warning("OTEL_TRACES_EXPORTER is %r; known are otlp, console and none: no spans are sent", exporter_name)
    return None


LogFormat = Literal["text", "json"]
FIELDS = "fields"
"""Attribute of a log record with further members of its JSON line, by name."""
_request: ContextVar[str | None] = ContextVar("dynident_request", default=None)
_job: ContextVar[str | None] = ContextVar("dynident_job", default=None)


def configure_logging(level: str, form: LogFormat) -> None:
    """Write all log lines of this process to its standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines() if form == "json" else TextLines())
    logging.basicConfig(level=level.upper(), handlers=[handler])
    # At its usual level it reports its own set-up at every start.
    logging.getLogger("alembic").setLevel(logging.WARNING)


def get_current_request() -> str | None:
    """Return the id of the request that is answered here, or that submitted the current job."""
    return _request.get()


def get_current_job() -> str | None:
    """Return the id of the current job."""
    return _job.get()


def set_current_request(request_id: str) -> None:
    """Set the request that is answered from now on, in this task and in the tasks that it starts."""
    _request.set(request_id)


@contextmanager
def set_log_context(job_id: str | None, request_id: str | None) -> Iterator[None]:
    """Set the current job, and the request that submitted it, in this context."""
    job, request = _job.set(job_id), _request.set(request_id)
    try:
        yield
    finally:
        _job.reset(job)
        _request.reset(request)


def format_time(record: logging.LogRecord) -> str:
    """Return the time of a log record in RFC 3339, UTC."""
    return datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")


class TextLines(logging.Formatter):
    """`2026-11-27T03:01:41.512+00:00 INFO dynident.access: GET /v1/robots 200 in 3.1 ms [request 5f0c…]`."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s")

    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:
        """Return the time in the format of JSON lines."""
        return format_time(record)

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Format a line without its traceback."""
        known = [f"{name} {value}" for name, value in (("job", _job.get()), ("request", _request.get())) if value]
        return super().formatMessage(record) + (f" [{', '.join(known)}]" if known else "")


class JsonLines(logging.Formatter):
    """Formatter with one JSON object per line: `time` (RFC 3339, UTC), `level`, `logger`, `message`, and others."""

    def format(self, record: logging.LogRecord) -> str:
        """Format one line."""
        members = {
            "time": format_time(record),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            "request_id": _request.get(),
            "job_id": _job.get(),
            "exception": self.formatException(record.exc_info) if record.exc_info else None,
            **getattr(record, FIELDS, {}),
        }
        return json.dumps({name: value for name, value in members.items() if value is not None}, default=str)
