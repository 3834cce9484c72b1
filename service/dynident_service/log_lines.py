"""Format log lines as text or JSON, with request and job ids."""

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
