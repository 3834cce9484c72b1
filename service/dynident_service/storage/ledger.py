"""The ledger of jobs: what is to be done, who does it, until when, and how far it is.

Whoever works on a job holds it by a lease. All writes of a worker carry (job id, attempt), so one that was given up
for dead and comes back cannot overwrite what its successor does.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Literal, cast

from sqlalchemy import Connection, Row, bindparam, exists, func, select
from sqlalchemy.orm import Session

from dynident_service.problems import Problem, ProblemError, not_found
from dynident_service.storage import turns
from dynident_service.storage.database import AT_ONCE, Database, clock
from dynident_service.storage.reading import OF_JOBS
from dynident_service.storage.records import FINAL, Job, JobEvent, NewJob, State
from dynident_service.storage.tables import EVENTS, JOBS, JobRow
from dynident_service.storage.turns import Claim

LEASE = timedelta(seconds=30)
"""Longer than anybody waits for a lock, by the clock of the database."""
PICK_UP = timedelta(seconds=30)
"""A claimed job may wait as long for a worker to begin."""
SECOND_LOOK = 5.0
"""A lease that ran out is looked at again after so many seconds: where the database or the machine was away for a
while, its holder renews it as soon as it can."""
MOST_LOSSES = 50
"""A job whose worker was lost so often takes it down, most probably."""

# What is asked again and again is put together once.
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
"""A job, its attempt, and until when it was held."""


@dataclass(frozen=True)
class Strain:
    """What tells whoever runs the service that something is wrong."""

    oldest_queued: float
    """Seconds that the oldest queued job has waited since it was accepted."""
    deaths: int
    """How often a computation died by itself."""
    losses: int
    """How often a job was lost with its worker, or its database or store."""


class LostClaim(Exception):
    """The job was given to another worker, or cancelled: what this one does counts no more."""


class Ledger:
    """Jobs as the database knows them."""

    def __init__(self, database: Database, max_attempts: int = 3) -> None:
        self._database = database
        self._max_attempts = max_attempts
        self._expired: dict[Claimed, float] = {}

    def enqueue(self, new: NewJob, resource_id: str | None = None) -> str:
        """Add a job."""
        with self._database.write() as session:
            (job,) = turns.add_jobs(session, [(new, resource_id)], clock(session))
            return job.id

    def claim(self, slots: int, own: Collection[str] | None = None) -> list[Claim]:
        """Take as many queued jobs as there are free slots; leases that ran out free their jobs.

        Each is the oldest of the key of which the fewest run, so that nobody waits behind all the jobs of another.

        A slot is taken by each running job of `own`, the ids of those that were given to these slots; by whichever job
        runs where that is not known.
        """
        with self._database.read() as session:
            connection = session.connection()
            expired, queued = connection.execute(_LOOK, {"moment": clock(session)}).one()
            if not expired:
                self._expired = {}
                if not queued or _running(connection, own) >= slots:
                    return []  # without a transaction that writes, which others would wait for
        with self._database.write() as session:
            connection, moment = session.connection(), clock(session)
            if expired:
                for row in self._expired_for_long(turns.find_expired(connection, moment)):
                    turns.bury(session, row, MOST_LOSSES, "its worker was lost", losses=1)
            free = slots - _running(connection, own)
            return turns.take(connection, free, moment, moment + PICK_UP) if free > 0 else []

    def standing(self, claim: Claim) -> Standing:
        """Tell whether a claim still holds, without renewing it."""
        with self._database.read() as session:
            row = session.connection().execute(_STANDING, {"id": claim.job_id}).one_or_none()
            if row is None or row.attempt != claim.attempt or row.state != "running":
                return "lost"
            return "cancel" if row.cancel_requested else "held"

    def renew(self, claim: Claim) -> Standing:
        """Renew the lease of a claim."""
        with self._database.write() as session:
            cancelled = turns.hold_on(session.connection(), claim, clock(session) + LEASE)
        return "lost" if cancelled is None else "cancel" if cancelled else "held"

    def progress(self, claim: Claim, fraction: float, message: str) -> None:
        """Record how far a job is; raises LostClaim if nobody waits for it any more."""
        with self._database.write() as session:
            if not turns.go_on(session.connection(), claim, fraction, message):
                raise LostClaim(claim.job_id)

    def succeed(self, claim: Claim, store: Callable[[Session], None]) -> None:
        """Finish a job: its results are stored and its state is set in one transaction, or neither."""
        with self._database.write() as session:
            # First of all: who wants to cancel it waits until it has ended.
            if not turns.go_on(session.connection(), claim, 1.0, "done"):
                raise LostClaim(claim.job_id)
            store(session)
            session.flush()
            turns.end(session, claim.job_id, "succeeded")

    def fail(self, claim: Claim, problem: Problem) -> None:
        """Finish a job that cannot be done, with the reason."""
        self._if_held(claim, lambda session, _: turns.end(session, claim.job_id, "failed", problem))

    def stopped(self, claim: Claim) -> None:
        """Record that a job was stopped as asked."""
        self._if_held(claim, lambda session, _: turns.end(session, claim.job_id, "cancelled"))

    def lost(self, claim: Claim, reason: str) -> None:
        """Record that a job could not go on through no fault of its own: it is queued again."""
        self._if_held(claim, lambda session, row: turns.bury(session, row, MOST_LOSSES, reason, losses=1))

    def died(self, claim: Claim, reason: str) -> None:
        """Record that the process of a job died by itself: it is queued again, unless that happened too often."""
        self._if_held(claim, lambda session, row: turns.bury(session, row, self._max_attempts, reason, deaths=1))

    def release(self, claim: Claim) -> None:
        """Give a job back that could not be worked on, through no fault of its own."""
        self._if_held(claim, lambda session, row: turns.requeue(session.connection(), row))

    def cancel(self, job_id: str) -> Job:
        """Ask for a job to be stopped; one that has not begun is cancelled at once, one that ended is left as it is."""
        with self._database.write() as session:
            row = session.get(JobRow, job_id, with_for_update=True)
            if row is None:
                raise not_found("job", job_id)
            if row.state == "queued":
                turns.end(session, job_id, "cancelled")
                session.refresh(row)
            elif row.state == "running":
                row.cancel_requested = True
            elif row.state != "cancelled":
                detail = f"The job {job_id} has already {row.state}; there is nothing to cancel."
                raise ProblemError(409, detail, title="Already finished")
            return as_job(row)

    def cancel_of_resources(self, identifiers: Sequence[str]) -> None:
        """Ask for the jobs of resources to be stopped, all of them or none; those that ended are left as they are."""
        with self._database.write() as session:
            moment = clock(session)
            for start in range(0, len(identifiers), AT_ONCE):
                turns.cancel_all(session.connection(), identifiers[start : start + AT_ONCE], moment)

    def get(self, job_id: str) -> Job:
        """Read one job; a problem 404 if there is none."""
        with self._database.read() as session:
            row = session.connection().execute(_ONE, {"id": job_id}).one_or_none()
            if row is None:
                raise not_found("job", job_id)
            return as_job(row)

    def of_resources(self, identifiers: Sequence[str]) -> dict[str, tuple[str, State]]:
        """Give the job and its state of each of some resources, of those that are there."""
        jobs = select(JobRow.resource_id, JobRow.id, JobRow.state)
        found: dict[str, tuple[str, State]] = {}
        with self._database.read() as session:
            for start in range(0, len(identifiers), AT_ONCE):
                part = identifiers[start : start + AT_ONCE]
                for resource, job, state in session.execute(jobs.where(JobRow.resource_id.in_(part))):
                    found[str(resource)] = (job, cast(State, state))
        return found

    def page(
        self, limit: int, cursor: str | None = None, state: str | None = None, kind: str | None = None
    ) -> tuple[list[Job], str | None]:
        """Read a part of the list of jobs, newest first, and the cursor of the next part."""
        query = select(JobRow).order_by(JobRow.id.desc()).limit(limit + 1)
        for column, value in ((JobRow.state, state), (JobRow.kind, kind)):
            if value is not None:
                query = query.where(column == value)
        if cursor is not None:
            query = query.where(JobRow.id < cursor)
        with self._database.read() as session:
            rows = session.scalars(query).all()
        jobs = [as_job(row) for row in rows[:limit]]
        return jobs, jobs[-1].id if len(rows) > limit else None

    def history(self, job_id: str, after: int = 0) -> tuple[list[JobEvent], bool]:
        """Read the events of a job after one, and whether the job has ended (so that none will follow these)."""
        with self._database.read() as session:
            connection = session.connection()
            found = connection.execute(_STANDING, {"id": job_id}).one_or_none()
            rows = connection.execute(_HISTORY, {"id": job_id, "after": after}).all()
        return [JobEvent(row.id, row.event, row.data) for row in rows], found is None or found.state in FINAL

    def news(self, after: int, job_ids: Collection[str]) -> tuple[dict[str, int], int]:
        """Give the id of the last event of each job that has one after an event, and of each of some jobs, of those
        that are there; and the event after which to ask the next time. After 0 only these some are told.
        """
        with self._database.read() as session:
            connection = session.connection()
            if after:
                found = {str(job_id): int(event) for job_id, event in connection.execute(_AFTER, {"after": after})}
                last = max(found.values(), default=after)
            else:
                found, last = {}, int(connection.execute(_LAST).scalar() or 0)
            if job_ids:
                rows = connection.execute(_NEWEST, {"ids": list(job_ids)})
                found |= {str(job_id): int(event) for job_id, event in rows}
        return found, last

    def counts(self) -> dict[str, int]:
        """Count the jobs by state."""
        with self._database.read() as session:
            rows = session.execute(select(JobRow.state, func.count()).group_by(JobRow.state)).all()
        return {str(state): int(number) for state, number in rows}

    def strain(self) -> Strain:
        """Tell how long the queue is in time, and how often jobs that are kept had to be begun again."""
        with self._database.read() as session:
            oldest = session.scalar(select(func.min(JobRow.created_at)).where(JobRow.state == "queued"))
            deaths, losses = session.execute(select(func.sum(JobRow.deaths), func.sum(JobRow.losses))).one()
            waited = 0.0 if oldest is None else max(0.0, (clock(session) - oldest).total_seconds())
        return Strain(waited, int(deaths or 0), int(losses or 0))

    def _if_held(self, claim: Claim, write: Callable[[Session, Row[object]], None]) -> None:
        with self._database.write() as session:
            row = turns.find_held(session.connection(), claim)
            if row is not None:
                write(session, row)

    def _expired_for_long(self, rows: Sequence[Row[Any]]) -> list[Row[Any]]:
        """Those whose leases had run out already when they were looked at before, some time ago."""
        moment = time.monotonic()
        before, self._expired = self._expired, {}
        found = []
        for row in rows:
            claimed = (row.id, row.attempt, row.lease_until)
            since = self._expired[claimed] = before.get(claimed, moment)
            if moment - since >= SECOND_LOOK:
                found.append(row)
        return found


def as_job(row: JobRow | Row[object]) -> Job:
    """Take a job off its row."""
    return Job(*(getattr(row, name) for name in OF_JOBS))


def _running(connection: Connection, own: Collection[str] | None) -> int:
    if own is None:
        return int(connection.execute(_RUNNING).scalar_one())
    return int(connection.execute(_OUR_RUNNING, {"own": list(own)}).scalar_one()) if own else 0
