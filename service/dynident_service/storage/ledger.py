"""The ledger of jobs: what is to be done, who does it, until when, and how far it is.

Whoever works on a job holds it by a lease. All writes of a worker carry (job id, attempt), so one that was given up
for dead and comes back cannot overwrite what its successor does.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Literal, cast

from sqlalchemy import Row, bindparam, delete, func, insert, select
from sqlalchemy.orm import Session

from dynident_service import traces
from dynident_service.logs import current_request
from dynident_service.problems import Problem, ProblemError, make_problem, not_found
from dynident_service.storage.database import AT_ONCE, Database, clock
from dynident_service.storage.identifiers import new_identifier
from dynident_service.storage.records import FINAL, Job, JobEvent, NewJob, State
from dynident_service.storage.tables import EVENTS, JOBS, CheckpointRow, JobEventRow, JobRow

LEASE = timedelta(seconds=30)
"""Longer than anybody waits for a lock, by the clock of the database."""
PICK_UP = timedelta(seconds=30)
"""A claimed job may wait as long for a worker to begin."""
SECOND_LOOK = 5.0
"""A lease that ran out is looked at again after so many seconds: where the database or the machine was away for a
while, its holder renews it as soon as it can."""
MOST_LOSSES = 50
"""A job whose worker was lost so often takes it down, most probably."""
REQUEST = "dynident.request"
"""Where the arguments of a job have the request that submitted it; its function is not given that."""

TRACE = "dynident.trace"
"""And its span, where it was traced."""

# What is asked again and again is put together once.
_ADD_JOBS, _ADD_EVENTS = insert(JOBS), insert(EVENTS)
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
_WAITING = select(JOBS.c.id).where((JOBS.c.state == "queued") | _HAS_EXPIRED).limit(1)
Standing = Literal["held", "cancel", "lost"]
Claimed = tuple[str, int, datetime | None]
"""A job, its attempt, and until when it was held."""


@dataclass(frozen=True)
class Claim:
    """The right to work on a job; the attempt fences off earlier holders."""

    job_id: str
    attempt: int
    function: str
    arguments: Mapping[str, Any]
    resource_id: str | None
    request_id: str | None = None
    """The request that submitted the job, for the log."""
    trace: str | None = None
    """The span of that request, where it was traced."""


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
            (job,) = add_jobs(session, [(new, resource_id)], clock(session))
            return job.id

    def claim(self, slots: int, own: Collection[str] | None = None) -> list[Claim]:
        """Take as many queued jobs, oldest first, as there are free slots; leases that ran out free their jobs.

        A slot is taken by each running job of `own`, the ids of those that were given to these slots; by whichever job
        runs where that is not known.
        """
        if not self._has_work():
            return []
        with self._database.write() as session:
            expired = select(JobRow).where(JobRow.state == "running", JobRow.lease_until < clock(session))
            rows = session.scalars(expired.with_for_update(skip_locked=True)).all()
            for row in self._expired_for_long(rows):
                self._lose(session, row, "its worker was lost")
            taken = select(func.count()).where(JobRow.state == "running")
            if own is not None:
                taken = taken.where(JobRow.id.in_(own))
            running = session.scalar(taken) or 0
            queued = select(JobRow).where(JobRow.state == "queued").order_by(JobRow.id).limit(max(0, slots - running))
            return [_start(session, row) for row in session.scalars(queued.with_for_update(skip_locked=True))]

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
            row = _held(session, claim)
            if row is None:
                return "lost"
            row.lease_until = clock(session) + LEASE
            return "cancel" if row.cancel_requested else "held"

    def progress(self, claim: Claim, fraction: float, message: str) -> None:
        """Record how far a job is; raises LostClaim if nobody waits for it any more."""
        with self._database.write() as session:
            row = _held(session, claim)
            if row is None or row.cancel_requested:
                raise LostClaim(claim.job_id)
            row.fraction, row.message = fraction, message[:300]
            _record(session, row, "progress", {"fraction": fraction, "message": row.message})

    def succeed(self, claim: Claim, store: Callable[[Session], None]) -> None:
        """Finish a job: its results are stored and its state is set in one transaction, or neither."""
        with self._database.write() as session:
            row = _held(session, claim)
            if row is None or row.cancel_requested:
                raise LostClaim(claim.job_id)
            store(session)
            row.fraction, row.message = 1.0, "done"
            _record(session, row, "progress", {"fraction": 1.0, "message": "done"})
            _finish(session, row, "succeeded")

    def fail(self, claim: Claim, problem: Problem) -> None:
        """Finish a job that cannot be done, with the reason."""
        with self._database.write() as session:
            row = _held(session, claim)
            if row is not None:
                _finish(session, row, "failed", problem)

    def stopped(self, claim: Claim) -> None:
        """Record that a job was stopped as asked."""
        with self._database.write() as session:
            row = _held(session, claim)
            if row is not None:
                _finish(session, row, "cancelled")

    def lost(self, claim: Claim, reason: str) -> None:
        """Record that a job could not go on through no fault of its own: it is queued again."""
        with self._database.write() as session:
            row = _held(session, claim)
            if row is not None:
                self._lose(session, row, reason)

    def died(self, claim: Claim, reason: str) -> None:
        """Record that the process of a job died by itself: it is queued again, unless that happened too often."""
        with self._database.write() as session:
            row = _held(session, claim)
            if row is not None:
                self._bury(session, row, reason)

    def release(self, claim: Claim) -> None:
        """Give a job back that could not be worked on, through no fault of its own."""
        with self._database.write() as session:
            row = _held(session, claim)
            if row is not None:
                _requeue(session, row)

    def cancel(self, job_id: str) -> Job:
        """Ask for a job to be stopped; one that has not begun is cancelled at once, one that ended is left as it is."""
        with self._database.write() as session:
            row = session.get(JobRow, job_id, with_for_update=True)
            if row is None:
                raise not_found("job", job_id)
            if row.state == "queued":
                _finish(session, row, "cancelled")
            elif row.state == "running":
                row.cancel_requested = True
            elif row.state != "cancelled":
                detail = f"The job {job_id} has already {row.state}; there is nothing to cancel."
                raise ProblemError(409, detail, title="Already finished")
            return as_job(row)

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

    def _has_work(self) -> bool:
        with self._database.read() as session:
            return session.connection().execute(_WAITING, {"moment": clock(session)}).first() is not None

    def _expired_for_long(self, rows: Sequence[JobRow]) -> list[JobRow]:
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

    def _bury(self, session: Session, row: JobRow, reason: str) -> None:
        row.deaths += 1
        _again(session, row, row.deaths, self._max_attempts, reason)

    def _lose(self, session: Session, row: JobRow, reason: str) -> None:
        row.losses += 1
        _again(session, row, row.losses, MOST_LOSSES, reason)


def add_jobs(
    session: Session, several: Sequence[tuple[NewJob, str | None]], moment: datetime, owner: str | None = None
) -> list[Job]:
    """Insert jobs of an owner, each for a resource or for none, within a transaction; the caller commits."""
    if not several:
        return []
    told = {REQUEST: current_request(), TRACE: traces.current()}
    more = {name: value for name, value in told.items() if value is not None}
    jobs = [
        Job(new_identifier("job"), new.kind, resource_id, "queued", 0.0, "", None, 0, moment, None, None)
        for new, resource_id in several
    ]
    rows = [
        {**vars(job), "owner": owner, "function": new.function, "arguments": {**new.arguments, **more}}
        for job, (new, _) in zip(jobs, several, strict=True)
    ]
    connection = session.connection()
    connection.execute(_ADD_JOBS, rows)
    events = [{"job_id": job.id, "event": "state", "data": {"state": "queued"}} for job in jobs]
    connection.execute(_ADD_EVENTS, events)
    return jobs


def as_job(row: JobRow | Row[Any]) -> Job:
    """Take a job off its row."""
    return Job(
        id=row.id,
        kind=row.kind,
        resource_id=row.resource_id,
        state=cast(State, row.state),
        fraction=row.fraction,
        message=row.message,
        error=row.error,
        attempt=row.attempt,
        created_at=row.created_at,
        started_at=row.started_at,
        finished_at=row.finished_at,
    )


def _held(session: Session, claim: Claim) -> JobRow | None:
    query = select(JobRow).where(JobRow.id == claim.job_id, JobRow.attempt == claim.attempt, JobRow.state == "running")
    return session.scalar(query.with_for_update())


def _again(session: Session, row: JobRow, times: int, most: int, reason: str) -> None:
    """Queue a job again, unless it is not wanted any more or was begun too often."""
    if row.cancel_requested:
        _finish(session, row, "cancelled")
    elif times >= most:
        detail = f"The job was given up after {times} attempts: the last time {reason}."
        _finish(session, row, "failed", make_problem(500, detail, title="Job given up"))
    else:
        _requeue(session, row)


def _start(session: Session, row: JobRow) -> Claim:
    row.state, row.attempt = "running", row.attempt + 1
    row.started_at = clock(session)
    row.lease_until = row.started_at + PICK_UP
    _record(session, row, "state", {"state": "running"})
    arguments = dict(row.arguments)
    request_id, trace = arguments.pop(REQUEST, None), arguments.pop(TRACE, None)
    return Claim(row.id, row.attempt, row.function, arguments, row.resource_id, request_id, trace)


def _requeue(session: Session, row: JobRow) -> None:
    row.state, row.lease_until, row.started_at = "queued", None, None
    row.fraction, row.message = 0.0, ""
    _record(session, row, "state", {"state": "queued"})


def _finish(session: Session, row: JobRow, state: State, problem: Problem | None = None) -> None:
    session.execute(delete(CheckpointRow).where(CheckpointRow.job_id == row.id))
    row.state, row.lease_until, row.finished_at = state, None, clock(session)
    row.error = None if problem is None else problem.model_dump(exclude_none=True)
    data = {"state": state} if row.error is None else {"state": state, "error": row.error}
    _record(session, row, "state", data)


def _record(session: Session, row: JobRow, event: str, data: dict[str, Any]) -> None:
    session.add(JobEventRow(job_id=row.id, event=event, data=data))
