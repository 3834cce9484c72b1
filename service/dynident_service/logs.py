"""Log lines: as text or as JSON, each with the request and the job that it belongs to."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Literal

LogFormat = Literal["text", "json"]
FIELDS = "fields"
"""The attribute of a record that holds what JSON has as members of its own, by name."""
_request: ContextVar[str | None] = ContextVar("dynident_request", default=None)
_job: ContextVar[str | None] = ContextVar("dynident_job", default=None)


def configure(level: str, form: LogFormat) -> None:
    """Write all log lines of this process to its standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines() if form == "json" else TextLines())
    logging.basicConfig(level=level.upper(), handlers=[handler])
    logging.getLogger("alembic").setLevel(logging.WARNING)


def current_request() -> str | None:
    """Give the id of the request that is answered here, or that submitted the job that is done here."""
    return _request.get()


def current_job() -> str | None:
    """Give the id of the job that is done here."""
    return _job.get()


def answering(request_id: str) -> None:
    """Say which request is answered from here on, in this task and in what it starts."""
    _request.set(request_id)


@contextmanager
def working_on(job_id: str | None, request_id: str | None) -> Iterator[None]:
    """Say which job is done meanwhile, and which request submitted it."""
    job, request = _job.set(job_id), _request.set(request_id)
    try:
        yield
    finally:
        _job.reset(job)
        _request.reset(request)


def time_of(record: logging.LogRecord) -> str:
    """Give the time of a line: RFC 3339, UTC."""
    return datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")


class TextLines(logging.Formatter):
    """`2026-11-27T03:01:41.512+00:00 INFO dynident.access: GET /v1/robots 200 in 3.1 ms [request 5f0c…]`."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s")

    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:
        """Give the time as JSON lines do."""
        return time_of(record)

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Write a line, but for what was raised."""
        known = [f"{name} {value}" for name, value in (("job", _job.get()), ("request", _request.get())) if value]
        return super().formatMessage(record) + (f" [{', '.join(known)}]" if known else "")


class JsonLines(logging.Formatter):
    """One JSON object a line: `time` (RFC 3339, UTC), `level`, `logger`, `message`, and what is known besides."""

    def format(self, record: logging.LogRecord) -> str:
        """Write one line."""
        told = {
            "time": time_of(record),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            "request_id": _request.get(),
            "job_id": _job.get(),
            "exception": self.formatException(record.exc_info) if record.exc_info else None,
            **getattr(record, FIELDS, {}),
        }
        return json.dumps({name: value for name, value in told.items() if value is not None}, default=str)
