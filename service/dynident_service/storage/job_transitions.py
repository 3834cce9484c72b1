"""SQL statements of a job's state changes: add, claim, renew, requeue, finish, cancel.

The statements use SQLAlchemy's Core and are compiled once: SQLite has a single writer, for which all others wait.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, bindparam, case, delete, func, insert, select, update
from sqlalchemy.orm import Session
from sqlalchemy.sql.dml import ReturningUpdate

from dynident_service import tracing
from dynident_service.problems import Problem, make_problem
from dynident_service.storage.database import get_database_time
from dynident_service.storage.database_tables import CHECKPOINTS, EVENTS, JOBS
from dynident_service.storage.repository_values import Job, NewJob, State, create_identifier
from dynident_service.tracing import get_current_request

# Jobs that an earlier version queued name their functions by modules of former folders; some of these modules are
# parts of others now.
_FORMER_FUNCTION = re.compile(r"^dynident_service\.(?:work|job_functions)\.(\w+):")
_FORMER_MODULES = {"current_models": "drive_gains", "series": "diagnoses", "simulations": "designs"}

REQUEST = "dynident.request"
"""Key in the stored arguments of a job for the id of the request that submitted it; its function does not get it."""
TRACE = "dynident.trace"
"""Key in the stored arguments for the span of that request, if it was traced."""

_ADD_JOBS, _ADD_EVENTS = insert(JOBS), insert(EVENTS)
_OF_HELD = (JOBS.c.id, JOBS.c.attempt, JOBS.c.lease_until, JOBS.c.cancel_requested, JOBS.c.deaths, JOBS.c.losses)
_THIS = JOBS.c.id == bindparam("job")
_HELD = (_THIS, JOBS.c.attempt == bindparam("claimed"), JOBS.c.state == "running")
_FIND_HELD: Select[Any] = select(*_OF_HELD).where(*_HELD).with_for_update()
_RENEW = update(JOBS).where(*_HELD).values(lease_until=bindparam("until")).returning(JOBS.c.cancel_requested)
_GO_ON = (
    update(JOBS)
    .where(*_HELD, JOBS.c.cancel_requested.is_(False))
    .values(fraction=bindparam("done"), message=bindparam("told"))
    .returning(JOBS.c.id)
)
_EXPIRED: Select[Any] = (
    select(*_OF_HELD)
    .where(JOBS.c.state == "running", JOBS.c.lease_until < bindparam("moment"))
    .with_for_update(skip_locked=True)
)
_QUEUED, _RUNNING = JOBS.c.state == "queued", JOBS.c.state == "running"
_FIRST_OWNER = select(func.min(JOBS.c.owner).label("owner")).where(_QUEUED).cte("owners", recursive=True)
_NEXT_OWNER = select(func.min(JOBS.c.owner)).where(_QUEUED, JOBS.c.owner > _FIRST_OWNER.c.owner).scalar_subquery()
_OWNERS = _FIRST_OWNER.union_all(select(_NEXT_OWNER).where(_FIRST_OWNER.c.owner.is_not(None)))
"""Owners that have queued jobs. The recursion finds each by the index from the previous one, however many jobs there
are. The last row is NULL, for jobs without an owner.
"""


def _query_each_owner(query: Select[Any]) -> ColumnElement[Any]:
    """Return a subquery for the jobs of each owner; only written twice PostgreSQL uses the index for both cases."""
    of_nobody = query.where(JOBS.c.owner.is_(None)).scalar_subquery()
    return case(
        (_OWNERS.c.owner.is_(None), of_nobody), else_=query.where(JOBS.c.owner == _OWNERS.c.owner).scalar_subquery()
    )


_TURNS: Select[Any] = select(
    _OWNERS.c.owner,
    _query_each_owner(select(func.min(JOBS.c.id)).where(_QUEUED)).label("oldest"),
    _query_each_owner(select(func.count()).where(_RUNNING)).label("running"),
)


def _build_claim_statement(*of_owner: ColumnElement[bool]) -> ReturningUpdate[Any]:
    # A separate common table expression, so that PostgreSQL searches once, whatever its plan for the update.
    # SKIP LOCKED lets several services claim at a time without waiting for each other.
    oldest = (
        select(JOBS.c.id)
        .where(_QUEUED, *of_owner)
        .order_by(JOBS.c.id)
        .limit(1)
        .with_for_update(skip_locked=True)
        .cte("oldest")
    )
    values = {"attempt": JOBS.c.attempt + 1, "started_at": bindparam("moment"), "lease_until": bindparam("until")}
    return (
        update(JOBS)
        .where(JOBS.c.id.in_(select(oldest.c.id)))
        .values(state="running", **values)
        .returning(JOBS.c.id, JOBS.c.attempt, JOBS.c.function, JOBS.c.arguments, JOBS.c.resource_id)
    )


_TAKE_OF_OWNER, _TAKE_OF_NOBODY = (
    _build_claim_statement(JOBS.c.owner == bindparam("of")),
    _build_claim_statement(JOBS.c.owner.is_(None)),
)
_REQUEUE = (
    update(JOBS)
    .where(_THIS)
    .values(state="queued", lease_until=None, started_at=None, fraction=0.0, message="")
    .values(deaths=bindparam("died"), losses=bindparam("lost"))
)
_END = (
    update(JOBS)
    .where(_THIS)
    .values(state=bindparam("ended"), lease_until=None, finished_at=bindparam("moment"), error=bindparam("problem"))
)
_COUNT_UP = update(JOBS).where(_THIS).values(deaths=bindparam("died"), losses=bindparam("lost"))
_THESE = JOBS.c.resource_id.in_(bindparam("resources", expanding=True))
_CANCEL_QUEUED = (
    update(JOBS).where(_THESE, _QUEUED).values(state="cancelled", finished_at=bindparam("moment")).returning(JOBS.c.id)
)
_CANCEL_RUNNING = update(JOBS).where(_THESE, _RUNNING).values(cancel_requested=True)
_FORGET_ALL = delete(CHECKPOINTS).where(CHECKPOINTS.c.job_id.in_(bindparam("jobs", expanding=True)))
_FORGET = delete(CHECKPOINTS).where(CHECKPOINTS.c.job_id == bindparam("job"))


@dataclass(frozen=True)
class Claim:
    """Right of a worker to work on a job; the number of the attempt excludes earlier holders."""

    job_id: str
    attempt: int
    function: str
    arguments: Mapping[str, Any]
    resource_id: str | None
    request_id: str | None = None
    """Request that submitted the job, for the log."""
    trace: str | None = None
    """Span of that request, if it was traced."""

    @property
    def key_parameters(self) -> dict[str, object]:
        """Parameters with which a statement finds the job while the claim holds."""
        return {"job": self.job_id, "claimed": self.attempt}


def add_jobs(
    session: Session, several: Sequence[tuple[NewJob, str | None]], moment: datetime, owner: str | None = None
) -> list[Job]:
    """Insert queued jobs within a transaction; the caller commits.

    Each job comes with the id of its resource; the jobs are returned in the same order.
    """
    if not several:
        return []
    # Stored with the arguments, so that the log of the job, in another process, names the request that asked for it.
    origin = {REQUEST: get_current_request(), TRACE: tracing.get_current_span()}
    more = {name: value for name, value in origin.items() if value is not None}
    jobs = [
        Job(create_identifier("job"), new.kind, resource_id, "queued", 0.0, "", None, 0, moment, None, None)
        for new, resource_id in several
    ]
    rows = [
        {**vars(job), "owner": owner, "function": new.function, "arguments": {**new.arguments, **more}}
        for job, (new, _) in zip(jobs, several, strict=True)
    ]
    connection = session.connection()
    connection.execute(_ADD_JOBS, rows)
    _add_event(connection, [job.id for job in jobs], {"state": "queued"})
    return jobs


def claim_jobs(connection: Connection, most: int, moment: datetime, until: datetime) -> list[Claim]:
    """Claim queued jobs, always the oldest one of the owner with the fewest running jobs.

    `until` is the end of their lease.
    """
    claims: list[Claim] = []
    passed_over: set[str | None] = set()
    """Owners all of whose jobs others are about to take."""
    while len(claims) < most:
        # Counted again for each job, as the one before has changed the numbers.
        rows = [row for row in connection.execute(_TURNS) if row.oldest is not None and row.owner not in passed_over]
        if not rows:
            break
        owner = min(rows, key=lambda row: (row.running, row.oldest)).owner
        statement = _TAKE_OF_NOBODY if owner is None else _TAKE_OF_OWNER
        job = connection.execute(statement, {"moment": moment, "until": until, "of": owner}).one_or_none()
        # Another service has locked the last queued jobs of this owner: the next owner is tried.
        if job is None:
            passed_over.add(owner)
        else:
            claims.append(_to_claim(job))
    _add_event(connection, [claim.job_id for claim in claims], {"state": "running"})
    return claims


def find_held(connection: Connection, claim: Claim) -> Row[object] | None:
    """Return the row of a claimed job and lock it until the end of the transaction; None if the claim does not hold."""
    return connection.execute(_FIND_HELD, claim.key_parameters).one_or_none()


def find_expired(connection: Connection, moment: datetime) -> Sequence[Row[object]]:
    """Return and lock the rows of running jobs whose leases have expired."""
    return connection.execute(_EXPIRED, {"moment": moment}).all()


def extend_lease(connection: Connection, claim: Claim, until: datetime) -> bool | None:
    """Extend the lease of a claim. Return whether the job is to be cancelled; None if the claim does not hold."""
    return connection.execute(_RENEW, {**claim.key_parameters, "until": until}).scalar()


def record_progress(connection: Connection, claim: Claim, fraction: float, message: str) -> bool:
    """Record the progress of a job; return False if the claim does not hold or the job is to be cancelled."""
    # The column holds so many characters; PostgreSQL refuses more.
    shortened = message[:300]
    if connection.execute(_GO_ON, {**claim.key_parameters, "done": fraction, "told": shortened}).scalar() is None:
        return False
    _add_event(connection, [claim.job_id], {"fraction": fraction, "message": shortened}, "progress")
    return True


def requeue(connection: Connection, row: Row[object], *, deaths: int = 0, losses: int = 0) -> None:
    """Queue a job again, and add to its numbers of deaths and losses."""
    counted = {"job": row.id, "died": row.deaths + deaths, "lost": row.losses + losses}
    connection.execute(_REQUEUE, counted)
    _add_event(connection, [row.id], {"state": "queued"})


def requeue_or_fail(
    session: Session, row: Row[object], most: int, reason: str, *, deaths: int = 0, losses: int = 0
) -> None:
    """Queue a job again that died or was lost; end it if it was cancelled or that has happened `most` times."""
    connection = session.connection()
    # Deaths and losses are counted apart, as they have different limits.
    times = row.deaths + deaths if deaths else row.losses + losses
    if not row.cancel_requested and times < most:
        requeue(connection, row, deaths=deaths, losses=losses)
        return
    # The last one counts, too: the metrics add them up.
    connection.execute(_COUNT_UP, {"job": row.id, "died": row.deaths + deaths, "lost": row.losses + losses})
    if row.cancel_requested:
        finish_job(session, row.id, "cancelled")
    else:
        detail = f"The job was given up after {times} attempts; the reason of the last one: {reason}."
        finish_job(session, row.id, "failed", make_problem(500, detail, title="Job given up"))


def cancel_jobs(connection: Connection, resources: Sequence[str], moment: datetime) -> None:
    """Cancel the jobs of resources: queued ones at once, running ones by asking their workers."""
    ended = list(connection.execute(_CANCEL_QUEUED, {"resources": resources, "moment": moment}).scalars())
    # In this order: a job that another service claims between the two statements is running then, and is found here.
    connection.execute(_CANCEL_RUNNING, {"resources": resources})
    connection.execute(_FORGET_ALL, {"jobs": ended})
    _add_event(connection, ended, {"state": "cancelled"})


def finish_job(session: Session, job_id: str, state: State, problem: Problem | None = None) -> None:
    """Set the final state of a job, and delete its checkpoint."""
    connection = session.connection()
    error = None if problem is None else problem.model_dump(exclude_none=True)
    connection.execute(_FORGET, {"job": job_id})
    connection.execute(_END, {"job": job_id, "ended": state, "moment": get_database_time(session), "problem": error})
    _add_event(connection, [job_id], {"state": state} if error is None else {"state": state, "error": error})


def _add_event(connection: Connection, job_ids: Sequence[str], data: Mapping[str, Any], event: str = "state") -> None:
    """Add an event to the history of jobs."""
    if job_ids:
        connection.execute(_ADD_EVENTS, [{"job_id": job_id, "event": event, "data": data} for job_id in job_ids])


def _to_claim(row: Row[Any]) -> Claim:
    arguments = dict(row.arguments)
    # The function of the job does not take these two.
    request_id, trace = arguments.pop(REQUEST, None), arguments.pop(TRACE, None)
    function = _FORMER_FUNCTION.sub(
        lambda former: f"dynident_service.{_FORMER_MODULES.get(former[1], former[1])}.jobs:", row.function
    )
    return Claim(row.id, row.attempt, function, arguments, row.resource_id, request_id, trace)
