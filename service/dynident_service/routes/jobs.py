"""Routes of jobs: list, show, follow (event stream), cancel."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, Depends, Header, Query
from fastapi.sse import EventSourceResponse, ServerSentEvent

from dynident_service.routes.paging_and_retries import ListQueryDep, resource_path
from dynident_service.storage.repository_values import KINDS, Job, JobKind, State
from dynident_service.storage_and_engine import ServicesDep
from dynident_service.wire_types.jobs_and_usage import JobResource, JobView
from dynident_service.wire_types.shared_types import Page, Progress

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


def find_job(job_id: str, services: ServicesDep) -> Job:
    """Find the job before the stream begins: afterwards it is too late for a 404."""
    return services.job_queue.get(job_id)


@router.get("")
def list_jobs(
    services: ServicesDep,
    query: ListQueryDep,
    state: Annotated[State | None, Query()] = None,
    kind: Annotated[JobKind | None, Query()] = None,
) -> Page[JobView]:
    """List the jobs, newest first."""
    jobs, cursor = services.job_queue.list_page(query.limit, query.cursor, state, kind)
    return Page(items=[show_job(job) for job in jobs], cursor=cursor)


@router.get("/{job_id}")
def get_job(job_id: str, services: ServicesDep) -> JobView:
    """Show the state of a job."""
    return show_job(services.job_queue.get(job_id))


@router.post("/{job_id}/cancel")
def cancel_job(job_id: str, services: ServicesDep) -> JobView:
    """Cancel a job, even inside a solver; it ends within two seconds. A second request does no harm."""
    return show_job(services.job_queue.cancel(job_id))


@router.get("/{job_id}/events", response_class=EventSourceResponse)
async def follow_job(
    job: Annotated[Job, Depends(find_job)],
    services: ServicesDep,
    last_event_id: Annotated[str | None, Header(description="Resume after this event")] = None,
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
