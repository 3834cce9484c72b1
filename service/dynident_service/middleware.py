"""Middleware: request ids, access log, API-key check, audit log, timing; the metrics at `/metrics`.

Limits of requests are in `request_limits`.
"""

from __future__ import annotations

import logging
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from urllib.parse import quote, urlsplit

from anyio import CapacityLimiter, to_thread
from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dynident_service.api_keys import KeyHolder, KeyRing, extract_key, find_needed_scope
from dynident_service.problem_responses import REQUEST_ID, respond
from dynident_service.problems import Problem, make_problem
from dynident_service.request_limits import charge_key, get_quota_limits
from dynident_service.settings import Settings, is_loopback
from dynident_service.storage.job_queue import QueueHealth
from dynident_service.storage.quotas import Account, set_account
from dynident_service.tracing import FIELDS, set_current_request

VALID_REQUEST_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
"""Pattern of an id that is accepted from the caller; anything else would be written into the log unchecked."""
CLIENT_LEFT = 499
"""Status in the log of a request whose client left before the answer; HTTP has none for it."""
log = logging.getLogger("dynident.access")


class AccessLog:
    """Middleware that gives every request its id (`X-Request-ID`: the caller's, or a new one) and logs its answer.

    Query and headers are not logged, as they may hold credentials.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and log its status and duration."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        sent_identifier = Headers(scope=scope).get(REQUEST_ID, "")
        identifier = sent_identifier if VALID_REQUEST_ID.fullmatch(sent_identifier) else secrets.token_hex(8)
        # Never reset: an unexpected error is answered and logged outside of this middleware. As each request is a task
        # of its own, the id reaches no other request.
        set_current_request(identifier)
        status: int | None = None

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[REQUEST_ID] = identifier
            await send(message)

        began = time.perf_counter()
        without_answer = CLIENT_LEFT
        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            without_answer = 500
            raise
        finally:
            _log_request(scope, without_answer if status is None else status, 1e3 * (time.perf_counter() - began))


def _log_request(scope: Scope, status: int, milliseconds: float) -> None:
    holder = scope.get(HOLDER)
    key = holder.name if isinstance(holder, KeyHolder) else None
    path = quote(scope["path"])  # no line breaks, whatever was asked for
    fields = {
        "method": scope["method"],
        "path": path,
        "status": status,
        "milliseconds": round(milliseconds, 1),
        "key": key,
    }
    by = "" if key is None else f" by {key!r}"
    log.info("%s %s %d in %.1f ms%s", scope["method"], path, status, milliseconds, by, extra={FIELDS: fields})


OPEN_PATHS = frozenset({"/healthz", "/readyz"})
PAGE = "/workbench/"
HOLDER = "dynident.holder"
"""Key in the scope of a request for the holder of its API key."""
audit = logging.getLogger("dynident.audit")
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})


class AccessControl:
    """Middleware that requires an API key, or, without keys, protects the service from pages of other origins.

    A service on the loopback interface needs no key. A browser on the same machine could however be made to call it, by
    a host name that resolves to 127.0.0.1 or by a form on another page.
    """

    def __init__(self, app: ASGIApp, settings: Settings, keys: Callable[[], KeyRing]) -> None:
        self._app = app
        self._settings = settings
        self._keys = keys
        self._limits = get_quota_limits(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Admit a request, or answer it with a problem."""
        if scope["type"] != "http" or scope["path"] in OPEN_PATHS:
            return await self._app(scope, receive, send)
        headers = Headers(scope=scope)
        if self._settings.needs_keys:
            if scope["path"] == "/" or scope["path"].startswith(PAGE):
                return await self._app(scope, receive, send)  # the page holds no data, and asks for the key itself
            key = extract_key(headers)
            holder = None if key is None else await to_thread.run_sync(self._keys().find_holder, key)
            refused = _find_refusal(holder, scope["method"], scope["path"])
            if refused is not None:
                # HTTP asks for this header with every 401.
                challenge = {"www-authenticate": "Bearer"} if refused.status == 401 else None
                return await respond(refused, challenge)(scope, receive, send)
            scope[HOLDER] = holder
            assert holder is not None
            # Until now the request counted for its address: the key was not known yet.
            charge_key(scope, holder.name)
            set_account(Account(holder.name, holder.limits.fill_from(self._limits)))
        elif not is_loopback(_parse_host(headers.get("host", ""))):
            detail = (
                "Without API keys the service answers only to localhost; set DYNIDENT_REQUIRE_KEYS to open it to "
                "others."
            )
            return await respond(make_problem(421, detail))(scope, receive, send)
        if not self._may_come_from(headers, scope["method"]):
            detail = "Pages of this origin may not change data; DYNIDENT_ALLOWED_ORIGINS lists the origins that may."
            return await respond(make_problem(403, detail, title="Origin not allowed"))(scope, receive, send)
        return await self._app(scope, receive, send)

    def _may_come_from(self, headers: Headers, method: str) -> bool:
        origin = headers.get("origin")
        # Programs send no origin; browsers send it with every request that may change something.
        if origin is None or method in SAFE_METHODS or origin in self._settings.allowed_origins:
            return True
        # A page of this service has its own address as origin; every other page has another one.
        return urlsplit(origin).netloc == headers.get("host")


def _find_refusal(holder: KeyHolder | None, method: str, path: str) -> Problem | None:
    """Return the problem of a request that may not enter, or None."""
    if holder is None:
        detail = "This service needs an API key: send 'Authorization: Bearer …' or 'X-API-Key: …'."
        return make_problem(401, detail, title="API key needed")
    if holder.is_expired:
        detail = (
            f"The key {holder.name!r} expired on {holder.expires_at:%Y-%m-%d}; ask the operator of the service "
            "for a new one."
        )
        return make_problem(401, detail, title="API key expired")
    if not holder.is_allowed(method, path):
        needed = find_needed_scope(method, path)
        detail = f"The key {holder.name!r} has the scope {holder.scope}; {method} needs a key with the scope {needed}."
        return make_problem(403, detail, title="Not allowed by this key")
    return None


class _StatusRecorder:
    """Records the status of an answer; 500 if there was none."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self.status = 500

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
        await self._send(message)


class AuditLog:
    """Middleware that logs who changed what: every request with an unsafe method, without its query and its key."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Log the result of one request."""
        if scope["type"] != "http" or scope["method"] in SAFE_METHODS:
            return await self._app(scope, receive, send)
        noted = _StatusRecorder(send)
        try:
            await self._app(scope, receive, noted)
        finally:
            # After the answer: by now the key is known, and what became of the request.
            holder = scope.get(HOLDER)
            by = holder.name if isinstance(holder, KeyHolder) else "an unknown caller"
            owner = f" of {holder.owner!r}" if isinstance(holder, KeyHolder) and holder.owner else ""
            audit.info("%r%s: %s %r: %d", by, owner, scope["method"], scope["path"], noted.status)


class RequestTiming:
    """Middleware that counts requests and their duration by route."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Measure one request."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        noted = _StatusRecorder(send)
        started = time.perf_counter()
        try:
            await self._app(scope, receive, noted)
        finally:
            # The template, not the path: one series a route, not one a resource.
            route = getattr(scope.get("route"), "path", "none")
            self._metrics.count(scope["method"], route, noted.status, time.perf_counter() - started)


def _parse_host(header: str) -> str:
    return urlsplit(f"//{header}").hostname or ""


class Metrics:
    """Metrics of requests, which are counted here, and of jobs, which are read from the queue on demand."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        self.thread = CapacityLimiter(1)
        """A single thread renders the metrics, so that scrapes that hang with the database occupy no further ones."""
        self._requests = Counter(
            "dynident_requests", "Requests answered.", ("method", "route", "status"), registry=self._registry
        )
        self._seconds = Histogram(
            "dynident_request_seconds", "Time to answer.", ("method", "route"), registry=self._registry
        )

    def count(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request."""
        # The route is a template: labels of single resources would make a time series of each.
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(method, route).observe(seconds)

    def watch_jobs(self, counts: Callable[[], dict[str, int]], strain: Callable[[], QueueHealth], folder: Path) -> None:
        """Add the jobs by state, the age of the queue, deaths by cause, and the free disk space of a folder."""
        self._registry.register(_JobsCollector(counts, strain))
        self._registry.register(_DiskCollector(folder))

    def render_text(self) -> bytes:
        """Render all metrics in Prometheus' text format."""
        return generate_latest(self._registry)


class _JobsCollector(Collector):
    def __init__(self, counts: Callable[[], dict[str, int]], strain: Callable[[], QueueHealth]) -> None:
        self._counts = counts
        self._strain = strain

    def collect(self) -> Iterable[Metric]:
        family = GaugeMetricFamily("dynident_jobs", "Jobs in the queue.", labels=("state",))
        for state, number in self._counts().items():
            family.add_metric((state,), number)
        yield family
        strain = self._strain()
        age = "Waiting time of the oldest queued job."
        yield GaugeMetricFamily("dynident_oldest_queued_job_seconds", age, strain.oldest_queued)
        deaths = "Number of restarts of jobs whose computation died or whose worker was lost."
        again = GaugeMetricFamily("dynident_job_deaths", deaths, labels=("cause",))
        again.add_metric(("computation",), strain.deaths)
        again.add_metric(("infrastructure",), strain.losses)
        yield again


class _DiskCollector(Collector):
    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def collect(self) -> Iterable[Metric]:
        free = shutil.disk_usage(self._folder).free
        yield GaugeMetricFamily("dynident_free_disk_bytes", "Free space on the disk of the data directory.", free)
