"""The job queue: claims, leases and their length, lost workers, progress, checkpoints.

A worker holds a job by a lease. Every write of a worker names the job and the attempt, so a worker that was taken for
dead and comes back cannot overwrite what its successor writes. A long job saves checkpoints, from which the next
attempt continues; they are kept until the job ends.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Literal, cast

from sqlalchemy import Connection, Row, bindparam, exists, func, select
from sqlalchemy.orm import Session

from dynident_service.problems import Problem, ProblemError, make_not_found
from dynident_service.storage import job_transitions
from dynident_service.storage.database import (
    AT_ONCE,
    INFRASTRUCTURE_ERRORS,
    Database,
    describe_error,
    get_database_time,
)
from dynident_service.storage.database_tables import EVENTS, JOBS, CheckpointRow, JobRow
from dynident_service.storage.job_transitions import Claim
from dynident_service.storage.repository_values import FINAL, Job, JobEvent, NewJob, State
from dynident_service.storage.resource_rows import JOB_COLUMNS

LEASE = timedelta(seconds=30)
"""How long a claim holds without renewal, by the clock of the database; longer than anybody waits for a lock."""
FIRST_LEASE = timedelta(seconds=30)
"""How long a claimed job may wait for a worker to begin."""
SECOND_LOOK = 5.0
"""Seconds after which an expired lease is looked at again before its job is taken away. If the database or the machine
was away for a while, the holder renews its lease as soon as it can.
"""
MOST_LOSSES = 50
"""Upper limit for the workers that one job may lose; beyond it the job itself most probably kills them."""

# Statements that are executed often are compiled once.
_NEWEST = (
    select(EVENTS.c.job_id, func.max(EVENTS.c.id))
    .where(EVENTS.c.job_id.in_(bindparam("ids", expanding=True)))
    .group_by(EVENTS.c.job_id)
)
_ONE = select(JOBS).where(JOBS.c.id == bindparam("id"))
_STANDING = select(JOBS.c.attempt, JOBS.c.state, JOBS.c.cancel_requested).where(JOBS.c.id == bindparam("id"))
_HISTORY = (
    select(EVENTS.c.id, EVENTS.c.event, EVENTS.c.data)
    .where(EVENTS.c.job_id == bindparam("id"), EVENTS.c.id > bindparam("after"))
    .order_by(EVENTS.c.id)
)
_AFTER = select(EVENTS.c.job_id, EVENTS.c.id).where(EVENTS.c.id > bindparam("after")).order_by(EVENTS.c.id)
_LAST = select(func.max(EVENTS.c.id))
_HAS_EXPIRED = (JOBS.c.state == "running") & (JOBS.c.lease_until < bindparam("moment"))
_LOOK = select(exists().where(_HAS_EXPIRED), exists().where(JOBS.c.state == "queued"))
_RUNNING = select(func.count()).where(JOBS.c.state == "running")
_OUR_RUNNING = _RUNNING.where(JOBS.c.id.in_(bindparam("own", expanding=True)))
Standing = Literal["held", "cancel", "lost"]
Claimed = tuple[str, int, datetime | None]
"""Job, attempt, and time until which the attempt holds the job."""


@dataclass(frozen=True)
class QueueHealth:
    """Figures that tell the operator of the service that something is wrong."""

    oldest_queued: float
    """Seconds that the oldest queued job has waited since it was accepted."""
    deaths: int
    """Number of times that the process of a computation died."""
    losses: int
    """Number of times that a job was lost with its worker, its database or its object store."""


class LostClaim(Exception):
    """The job was given to another worker or cancelled; results of this worker are no longer accepted."""


class JobQueue:
    """Queue of the jobs in the database. A job fails after its process has died `max_attempts` times."""

    def __init__(self, database: Database, max_attempts: int = 3) -> None:
        self._database = database
        self._max_attempts = max_attempts
        self._expired: dict[Claimed, float] = {}

    def enqueue(self, new: NewJob, resource_id: str | None = None) -> str:
        """Add a job, and return its id."""
        with self._database.write() as session:
            (job,) = job_transitions.add_jobs(session, [(new, resource_id)], get_database_time(session))
            return job.id

    def claim(self, slots: int, own: Collection[str] | None = None) -> list[Claim]:
        """Claim queued jobs for free slots; jobs whose lease has expired are queued again before.

        The next job is always the oldest one of the API key that has the fewest running jobs, so nobody waits behind
        all jobs of another user. `own` are the jobs that occupy these slots; without it every running job occupies one.
        """
        with self._database.read() as session:
            connection = session.connection()
            expired, queued = connection.execute(_LOOK, {"moment": get_database_time(session)}).one()
            # Most calls find nothing to do. They end here, in a transaction that only reads.
            if not expired:
                self._expired = {}
                if not queued or _count_running(connection, own) >= slots:
                    return []  # without a transaction that writes, which others would wait for
        with self._database.write() as session:
            connection, moment = session.connection(), get_database_time(session)
            if expired:
                for row in self._confirm_expired(job_transitions.find_expired(connection, moment)):
                    job_transitions.requeue_or_fail(session, row, MOST_LOSSES, "its worker was lost", losses=1)
            free = slots - _count_running(connection, own)
            return job_transitions.claim_jobs(connection, free, moment, moment + FIRST_LEASE) if free > 0 else []

    def get_standing(self, claim: Claim) -> Standing:
        """Return the standing of a claim without renewing it: "held", "cancel" (its job is to be stopped) or "lost"."""
        with self._database.read() as session:
            row = session.connection().execute(_STANDING, {"id": claim.job_id}).one_or_none()
            if row is None or row.attempt != claim.attempt or row.state != "running":
                return "lost"
            return "cancel" if row.cancel_requested else "held"

    def renew(self, claim: Claim) -> Standing:
        """Renew the lease of a claim, and return its standing as `get_standing` does."""
        with self._database.write() as session:
            cancelled = job_transitions.extend_lease(session.connection(), claim, get_database_time(session) + LEASE)
        return "lost" if cancelled is None else "cancel" if cancelled else "held"

    def record_progress(self, claim: Claim, fraction: float, message: str) -> None:
        """Record the progress of a job.

        Raise `LostClaim` if the claim does not hold any more, or the job is to be cancelled.
        """
        with self._database.write() as session:
            if not job_transitions.record_progress(session.connection(), claim, fraction, message):
                raise LostClaim(claim.job_id)

    def record_success(self, claim: Claim, store: Callable[[Session], None]) -> None:
        """Finish a job: store its results and its state in one transaction.

        `store` writes the results. Raise `LostClaim` if the claim does not hold any more, or the job is to be
        cancelled.
        """
        with self._database.write() as session:
            # This comes first, as it locks the row: a request to cancel the job then waits until the job has ended.
            if not job_transitions.record_progress(session.connection(), claim, 1.0, "done"):
                raise LostClaim(claim.job_id)
            store(session)
            session.flush()
            job_transitions.finish_job(session, claim.job_id, "succeeded")

    def record_failure(self, claim: Claim, problem: Problem) -> None:
        """Finish a job that cannot be done, with the problem that says why."""
        self._write_if_held(
            claim, lambda session, _: job_transitions.finish_job(session, claim.job_id, "failed", problem)
        )

    def record_cancellation(self, claim: Claim) -> None:
        """Record that a job was stopped because somebody cancelled it."""
        self._write_if_held(claim, lambda session, _: job_transitions.finish_job(session, claim.job_id, "cancelled"))

    def record_loss(self, claim: Claim, reason: str) -> None:
        """Queue a job again that was interrupted by a failure of the infrastructure."""
        self._write_if_held(
            claim, lambda session, row: job_transitions.requeue_or_fail(session, row, MOST_LOSSES, reason, losses=1)
        )

    def record_death(self, claim: Claim, reason: str) -> None:
        """Queue a job again whose process died; it fails if that has happened `max_attempts` times."""
        self._write_if_held(
            claim,
            lambda session, row: job_transitions.requeue_or_fail(session, row, self._max_attempts, reason, deaths=1),
        )

    def release(self, claim: Claim) -> None:
        """Give back a job that was claimed and not begun."""
        self._write_if_held(claim, lambda session, row: job_transitions.requeue(session.connection(), row))

    def cancel(self, job_id: str) -> Job:
        """Cancel a job: a queued one at once, a running one by asking its worker to stop.

        One that was cancelled before is left as it is. Refuse with 404 if there is none, with 409 if it has succeeded
        or failed.
        """
        with self._database.write() as session:
            row = session.get(JobRow, job_id, with_for_update=True)
            if row is None:
                raise make_not_found("job", job_id)
            # The row is locked: no worker claims the job while it is decided what to do with it.
            if row.state == "queued":
                job_transitions.finish_job(session, job_id, "cancelled")
                session.refresh(row)
            elif row.state == "running":
                row.cancel_requested = True
            elif row.state != "cancelled":
                detail = f"The job {job_id} has already {row.state}; there is nothing to cancel."
                raise ProblemError(409, detail, title="Already finished")
            return to_job(row)

    def cancel_jobs_of_resources(self, identifiers: Sequence[str]) -> None:
        """Cancel the jobs of several resources, all in one transaction; jobs that have ended are left as they are."""
        with self._database.write() as session:
            moment = get_database_time(session)
            for start in range(0, len(identifiers), AT_ONCE):
                job_transitions.cancel_jobs(session.connection(), identifiers[start : start + AT_ONCE], moment)

    def get(self, job_id: str) -> Job:
        """Return a job; raise a problem 404 if there is none."""
        with self._database.read() as session:
            row = session.connection().execute(_ONE, {"id": job_id}).one_or_none()
            if row is None:
                raise make_not_found("job", job_id)
            return to_job(row)

    def find_jobs_of_resources(self, identifiers: Sequence[str]) -> dict[str, tuple[str, State]]:
        """Return the job id and the state of the job of each resource that has one, by the id of the resource."""
        jobs = select(JobRow.resource_id, JobRow.id, JobRow.state)
        states: dict[str, tuple[str, State]] = {}
        with self._database.read() as session:
            for start in range(0, len(identifiers), AT_ONCE):
                part = identifiers[start : start + AT_ONCE]
                for resource, job, state in session.execute(jobs.where(JobRow.resource_id.in_(part))):
                    states[str(resource)] = (job, cast(State, state))
        return states

    def list_page(
        self, limit: int, cursor: str | None = None, state: str | None = None, kind: str | None = None
    ) -> tuple[list[Job], str | None]:
        """List jobs, newest first. Also return the cursor of the next page, if there is one."""
        # One row more than asked for tells whether there is a next page.
        query = select(JobRow).order_by(JobRow.id.desc()).limit(limit + 1)
        for column, value in ((JobRow.state, state), (JobRow.kind, kind)):
            if value is not None:
                query = query.where(column == value)
        if cursor is not None:
            query = query.where(JobRow.id < cursor)
        with self._database.read() as session:
            rows = session.scalars(query).all()
        jobs = [to_job(row) for row in rows[:limit]]
        return jobs, jobs[-1].id if len(rows) > limit else None

    def read_events(self, job_id: str, after: int = 0) -> tuple[list[JobEvent], bool]:
        """Read the events of a job that follow one.

        Also return whether the job has ended, so that no further event follows.
        """
        with self._database.read() as session:
            connection = session.connection()
            # The state is read before the events. Both come from one snapshot, so a job that has ended has all its
            # events.
            standing = connection.execute(_STANDING, {"id": job_id}).one_or_none()
            rows = connection.execute(_HISTORY, {"id": job_id, "after": after}).all()
        return [JobEvent(row.id, row.event, row.data) for row in rows], standing is None or standing.state in FINAL

    def find_newest_events(self, after: int, job_ids: Collection[str]) -> tuple[dict[str, int], int]:
        """Return the newest event of each job that has news.

        `after` is the event up to which the caller knows all; on the first call it is 0, which asks for `job_ids` only.
        Jobs of `job_ids` are looked up in any case. Return the newest event by job, and `after` of the next call.
        """
        with self._database.read() as session:
            connection = session.connection()
            # Ids of events only rise: what is new lies beyond the last one that was seen.
            if after:
                newest = {str(job_id): int(event) for job_id, event in connection.execute(_AFTER, {"after": after})}
                last = max(newest.values(), default=after)
            else:
                newest, last = {}, int(connection.execute(_LAST).scalar() or 0)
            if job_ids:
                rows = connection.execute(_NEWEST, {"ids": list(job_ids)})
                newest |= {str(job_id): int(event) for job_id, event in rows}
        return newest, last

    def count_by_state(self) -> dict[str, int]:
        """Return the number of jobs by state."""
        with self._database.read() as session:
            rows = session.execute(select(JobRow.state, func.count()).group_by(JobRow.state)).all()
        return {str(state): int(number) for state, number in rows}

    def measure_health(self) -> QueueHealth:
        """Return how long the oldest queued job has waited, and how often jobs had to be begun again."""
        with self._database.read() as session:
            oldest = session.scalar(select(func.min(JobRow.created_at)).where(JobRow.state == "queued"))
            # Over no rows a sum is NULL.
            deaths, losses = session.execute(select(func.sum(JobRow.deaths), func.sum(JobRow.losses))).one()
            waited = 0.0 if oldest is None else max(0.0, (get_database_time(session) - oldest).total_seconds())
        return QueueHealth(waited, int(deaths or 0), int(losses or 0))

    def _write_if_held(self, claim: Claim, write: Callable[[Session, Row[object]], None]) -> None:
        with self._database.write() as session:
            row = job_transitions.find_held(session.connection(), claim)
            if row is not None:
                write(session, row)

    def _confirm_expired(self, rows: Sequence[Row[Any]]) -> list[Row[Any]]:
        """Return the rows whose leases had already expired at a look some time ago."""
        moment = time.monotonic()
        # Only leases that are still expired are remembered: one that was renewed begins anew.
        before, self._expired = self._expired, {}
        confirmed = []
        for row in rows:
            claimed = (row.id, row.attempt, row.lease_until)
            since = self._expired[claimed] = before.get(claimed, moment)
            if moment - since >= SECOND_LOOK:
                confirmed.append(row)
        return confirmed


def to_job(row: JobRow | Row[object]) -> Job:
    """Convert a row of the table of jobs to a Job."""
    return Job(*(getattr(row, name) for name in JOB_COLUMNS))


def _count_running(connection: Connection, own: Collection[str] | None) -> int:
    if own is None:
        return int(connection.execute(_RUNNING).scalar_one())
    return int(connection.execute(_OUR_RUNNING, {"own": list(own)}).scalar_one()) if own else 0


CHECKPOINT_INTERVAL = 3.0
"""Seconds between checkpoints: at most about as much work is lost when a worker is killed."""
MAX_CHECKPOINT_SHARE = 0.05
"""Upper limit for the share of time that checkpoints take; one that takes long is written less often."""
log = logging.getLogger("dynident.job")


class JobCheckpoints:
    """Checkpoints of one attempt at a job; the attempt continues from the last checkpoint of any earlier one."""

    def __init__(self, storage: CheckpointStore, claim: Claim) -> None:
        self._storage = storage
        self._claim = claim
        self._next = time.monotonic() + CHECKPOINT_INTERVAL

    def load_last(self) -> bytes | None:
        """Return the last checkpoint of earlier attempts, or None."""
        # A first attempt has nothing to continue from, and need not ask.
        return self._storage.find(self._claim.job_id) if self._claim.attempt > 1 else None

    def save(self, make: Callable[[], bytes]) -> None:
        """Write a checkpoint if it is time; a database that is away costs only the checkpoint."""
        began = time.monotonic()
        if began < self._next:
            return
        try:
            self._storage.save(self._claim, make())
        except INFRASTRUCTURE_ERRORS as error:
            log.warning("job %s: a checkpoint could not be stored: %s", self._claim.job_id, describe_error(error))
        ended = time.monotonic()
        self._next = ended + max(CHECKPOINT_INTERVAL, (ended - began) / MAX_CHECKPOINT_SHARE)


MAX_CHECKPOINT_BYTES = 20_000_000
"""Upper limit in bytes; a larger checkpoint is not worth its place in the database."""


class CheckpointStore:
    """Store with the last checkpoint of each job."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def find(self, job_id: str) -> bytes | None:
        """Return the last checkpoint of a job, or None."""
        with self._database.read() as session:
            return session.scalar(select(CheckpointRow.content).where(CheckpointRow.job_id == job_id))

    def save(self, claim: Claim, content: bytes) -> None:
        """Replace the checkpoint of a job, unless the worker has lost its claim or the checkpoint is too large."""
        if len(content) > MAX_CHECKPOINT_BYTES:
            return
        with self._database.write() as session:
            # The lock on the job's row keeps it from ending in between, which would leave a checkpoint of a job that
            # has ended.
            held = select(JobRow.id).where(JobRow.id == claim.job_id, JobRow.attempt == claim.attempt)
            if session.scalar(held.where(JobRow.state == "running").with_for_update()) is not None:
                session.merge(CheckpointRow(job_id=claim.job_id, content=content))
