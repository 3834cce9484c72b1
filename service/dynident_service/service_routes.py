"""Routes of the service itself: health, metrics, usage, jobs, the catalogue of effects.

Holds what a follower of a job is told: its events, and after how long to connect again (1 s).
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import astuple
from datetime import datetime
from typing import Annotated, Literal

from anyio import to_thread
from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent
from prometheus_client import CONTENT_TYPE_LATEST
from pydantic import BaseModel, Field

from dynident.version import __version__
from dynident_service.api_keys import KeyHolder, list_keys
from dynident_service.middleware import HOLDER
from dynident_service.problems import Problem
from dynident_service.request_limits import get_quota_limits
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.resource_routes import PagesDep, resource_path
from dynident_service.shared.wire_types import Catalogue, Page, Progress, ViewModel
from dynident_service.storage.quotas import QuotaLimits, Usage, compute_all_usage, compute_usage, get_account
from dynident_service.storage.repository_values import KINDS, Job, JobKind, State
from dynident_service.storage_and_engine import Services, ServicesDep


class Quota(ViewModel):
    """An amount in use, and its limit."""

    used: int
    allowed: int | None = Field(description="`null` if there is no limit")


class KeyUsage(ViewModel):
    """What one key uses."""

    key: str | None = Field(
        description="Name of the key; `null` for resources without a key, or from before keys were counted"
    )
    bytes: Quota = Field(description="Of its recordings, imports and meshes; each file counts once")
    recordings: Quota = Field(description="Measurements, including those that unfinished simulations will make")
    jobs: Quota = Field(description="Queued or running")


class UsageView(ViewModel):
    """What is used, key by key."""

    items: list[KeyUsage]


class JobResource(ViewModel):
    """The resource that a job computes."""

    kind: str
    id: str
    href: str


class JobView(ViewModel):
    """A computation and its state."""

    id: str
    kind: JobKind
    state: State
    progress: Progress
    resource: JobResource | None
    error: Problem | None = None
    attempt: int = Field(description="How often it was started; more than once if a worker was lost.")
    created_at: datetime
    started_at: datetime | None = None
    finished_at: datetime | None = None


router = APIRouter(tags=["service"])


class Health(BaseModel):
    """The service answers."""

    status: Literal["ok"] = "ok"
    version: str = __version__


class Readiness(BaseModel):
    """Whether the service can do its work, part by part."""

    status: Literal["ready", "not_ready"]
    checks: dict[str, str]


@router.get("/healthz")
async def health() -> Health:
    """Report that the service answers."""
    return Health()


@router.get("/readyz", responses={503: {"model": Readiness}})
async def readiness(services: ServicesDep, response: Response) -> Readiness:
    """Report whether the service works and its stored data are complete; 503 if not.

    The check reads the database, stores an object and calls a child process, as for any request; the answers are at
    most a second old. While the engine starts, it accepts jobs already; while it drains, it accepts none, because the
    service ends.
    """
    checks = await services.readiness.collect_states()
    checks["engine"] = services.engine.condition
    checks["stored"] = services.housekeeping.condition
    ready = all(value in ("ok", "starting", "ready") for value in checks.values())
    response.status_code = 200 if ready else 503
    return Readiness(status="ready" if ready else "not_ready", checks=checks)


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def metrics(request: Request) -> Response:
    """Give metrics for Prometheus."""
    figures = request.app.state.metrics
    text = await to_thread.run_sync(figures.render_text, limiter=figures.thread)
    return Response(text, media_type=CONTENT_TYPE_LATEST)


usage_router = APIRouter(prefix="/v1/usage", tags=["service"])


@usage_router.get("")
def get_usage(request: Request, services: ServicesDep) -> UsageView:
    """Show what a key stores and computes, and its limits; a key that allows everything sees all keys."""
    account, holder = get_account(), request.scope.get(HOLDER)
    if account is None or not isinstance(holder, KeyHolder) or holder.scope == "admin":
        return _show_all_keys(services)
    with services.database.read() as session:
        return UsageView(items=[_show_key(account.name, compute_usage(session, account.name), account.limits)])


def _show_all_keys(services: Services) -> UsageView:
    defaults = get_quota_limits(services.settings)
    limits: dict[str | None, QuotaLimits] = {
        key.name: key.limits.fill_from(defaults) for key in list_keys(services.database)
    }
    # Resources without an owner are from a time without keys, and have no limit.
    limits[None] = QuotaLimits()
    if (account := get_account()) is not None:
        limits[account.name] = account.limits
    with services.database.read() as session:
        used_by_name = compute_all_usage(session)
    names = sorted(used_by_name.keys() | limits.keys(), key=lambda name: (name is None, name or ""))
    return UsageView(
        items=[_show_key(name, used_by_name.get(name, Usage()), limits.get(name, defaults)) for name in names]
    )


def _show_key(name: str | None, use: Usage, limits: QuotaLimits) -> KeyUsage:
    of_bytes, recordings, jobs = (
        Quota(used=number, allowed=limit or None) for number, limit in zip(astuple(use), astuple(limits), strict=True)
    )
    return KeyUsage(key=name, bytes=of_bytes, recordings=recordings, jobs=jobs)


jobs_router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


def find_job(job_id: str, services: ServicesDep) -> Job:
    """Find the job before the stream begins: afterwards it is too late for a 404."""
    return services.job_queue.get(job_id)


@jobs_router.get("")
def list_jobs(
    services: ServicesDep,
    pages: PagesDep,
    state: Annotated[State | None, Query()] = None,
    kind: Annotated[JobKind | None, Query()] = None,
) -> Page[JobView]:
    """List the jobs, newest first."""
    jobs, cursor = services.job_queue.list_page(pages.limit, pages.cursor, state, kind)
    return Page(items=[show_job(job) for job in jobs], cursor=cursor)


@jobs_router.get("/{job_id}")
def get_job(job_id: str, services: ServicesDep) -> JobView:
    """Show the state of a job."""
    return show_job(services.job_queue.get(job_id))


@jobs_router.post("/{job_id}/cancel")
def cancel_job(job_id: str, services: ServicesDep) -> JobView:
    """Cancel a job, even inside a solver; it ends within two seconds. A second request does no harm."""
    return show_job(services.job_queue.cancel(job_id))


@jobs_router.get("/{job_id}/events", response_class=EventSourceResponse)
async def follow_job(
    job: Annotated[Job, Depends(find_job)],
    services: ServicesDep,
    last_event_id: Annotated[str | None, Header(max_length=18, description="Resume after this event")] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Follow a job: events `progress` and `state`, from the first, until it ends."""
    # Whoever lost the connection continues behind the last event that arrived.
    last = int(last_event_id) if last_event_id is not None and last_event_id.isdecimal() else 0
    ended = False
    while not ended:
        events, ended = await to_thread.run_sync(services.job_queue.read_events, job.id, last)
        for event in events:
            last = event.id
            # `retry` has browsers wait a second before they connect again.
            yield ServerSentEvent(event=event.event, id=str(event.id), data=event.data, retry=1000)
        if not ended:
            await services.following.wait_for_news(job.id, last)


def show_job(job: Job) -> JobView:
    """Show a job."""
    resource = None
    if job.resource_id is not None:
        kind = KINDS[job.resource_id.partition("_")[0]]
        resource = JobResource(kind=kind, id=job.resource_id, href=resource_path(kind, job.resource_id))
    progress = Progress(fraction=job.fraction, message=job.message)
    return JobView.model_validate({**vars(job), "progress": progress, "resource": resource})


effects_router = APIRouter(prefix="/v1/effects", tags=["effects"])


@effects_router.get("")
def list_effects() -> Catalogue:
    """List all effects of the catalogue."""
    with hold_import_lock():
        from dynident_service.shared.field_by_field import show_catalogue

    return show_catalogue()
