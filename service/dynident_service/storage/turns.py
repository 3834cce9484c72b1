"""The turns of a job: it is taken, goes on, is given back, and ends; each is a few statements within a transaction.

By SQLAlchemy's Core, put together once: SQLite has one writer, which all others wait for meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, bindparam, case, delete, func, insert, select, update
from sqlalchemy.orm import Session
from sqlalchemy.sql.dml import ReturningUpdate

from dynident_service import traces
from dynident_service.logs import current_request
from dynident_service.problems import Problem, make_problem
from dynident_service.storage.database import clock
from dynident_service.storage.identifiers import new_identifier
from dynident_service.storage.records import Job, NewJob, State
from dynident_service.storage.tables import CHECKPOINTS, EVENTS, JOBS

REQUEST = "dynident.request"
"""Where the arguments of a job have the request that submitted it; its function is not given that."""
TRACE = "dynident.trace"
"""And its span, where it was traced."""

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
"""Who has queued jobs: each is found by the index from the one before, however many jobs there are. The last row is
NULL, for the jobs of nobody."""


def _of_each_owner(query: Select[Any]) -> ColumnElement[Any]:
    """Ask about the jobs of each of the owners; written twice, as only so PostgreSQL takes the index for both."""
    of_nobody = query.where(JOBS.c.owner.is_(None)).scalar_subquery()
    return case(
        (_OWNERS.c.owner.is_(None), of_nobody), else_=query.where(JOBS.c.owner == _OWNERS.c.owner).scalar_subquery()
    )


_TURNS: Select[Any] = select(
    _OWNERS.c.owner,
    _of_each_owner(select(func.min(JOBS.c.id)).where(_QUEUED)).label("oldest"),
    _of_each_owner(select(func.count()).where(_RUNNING)).label("running"),
)


def _take_oldest(*of_owner: ColumnElement[bool]) -> ReturningUpdate[Any]:
    # Apart, so that PostgreSQL looks for it once, however it finds the row that it writes.
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


_TAKE_OF_OWNER, _TAKE_OF_NOBODY = _take_oldest(JOBS.c.owner == bindparam("of")), _take_oldest(JOBS.c.owner.is_(None))
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

    @property
    def place(self) -> dict[str, object]:
        """By which statements find the job, as long as the claim holds."""
        return {"job": self.job_id, "claimed": self.attempt}


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
    _say(connection, [job.id for job in jobs], {"state": "queued"})
    return jobs


def take(connection: Connection, most: int, moment: datetime, until: datetime) -> list[Claim]:
    """Begin as many queued jobs, which are held until then: each the oldest of the owner of whom the fewest run."""
    claims: list[Claim] = []
    passed_over: set[str | None] = set()
    """Owners all of whose jobs others are about to take."""
    while len(claims) < most:
        rows = [row for row in connection.execute(_TURNS) if row.oldest is not None and row.owner not in passed_over]
        if not rows:
            break
        owner = min(rows, key=lambda row: (row.running, row.oldest)).owner
        statement = _TAKE_OF_NOBODY if owner is None else _TAKE_OF_OWNER
        job = connection.execute(statement, {"moment": moment, "until": until, "of": owner}).one_or_none()
        if job is None:
            passed_over.add(owner)
        else:
            claims.append(_claim(job))
    _say(connection, [claim.job_id for claim in claims], {"state": "running"})
    return claims


def find_held(connection: Connection, claim: Claim) -> Row[object] | None:
    """Give the job of a claim and keep it from others until this transaction ends; `None` where it holds no more."""
    return connection.execute(_FIND_HELD, claim.place).one_or_none()


def find_expired(connection: Connection, moment: datetime) -> Sequence[Row[object]]:
    """Give the jobs whose leases have run out, as `find_held`."""
    return connection.execute(_EXPIRED, {"moment": moment}).all()


def hold_on(connection: Connection, claim: Claim, until: datetime) -> bool | None:
    """Hold a job longer; tells whether it is to be cancelled, `None` where the claim holds no more."""
    return connection.execute(_RENEW, {**claim.place, "until": until}).scalar()


def go_on(connection: Connection, claim: Claim, fraction: float, message: str) -> bool:
    """Record how far a job is; tells whether anybody waits for it."""
    said = message[:300]
    if connection.execute(_GO_ON, {**claim.place, "done": fraction, "told": said}).scalar() is None:
        return False
    _say(connection, [claim.job_id], {"fraction": fraction, "message": said}, "progress")
    return True


def requeue(connection: Connection, row: Row[object], *, deaths: int = 0, losses: int = 0) -> None:
    """Give a job back, with so many more deaths and losses."""
    counted = {"job": row.id, "died": row.deaths + deaths, "lost": row.losses + losses}
    connection.execute(_REQUEUE, counted)
    _say(connection, [row.id], {"state": "queued"})


def bury(session: Session, row: Row[object], most: int, reason: str, *, deaths: int = 0, losses: int = 0) -> None:
    """Give a job back that died or was lost, unless it is not wanted any more or that happened too often."""
    connection = session.connection()
    times = row.deaths + deaths if deaths else row.losses + losses
    if not row.cancel_requested and times < most:
        requeue(connection, row, deaths=deaths, losses=losses)
        return
    connection.execute(_COUNT_UP, {"job": row.id, "died": row.deaths + deaths, "lost": row.losses + losses})
    if row.cancel_requested:
        end(session, row.id, "cancelled")
    else:
        detail = f"The job was given up after {times} attempts: the last time {reason}."
        end(session, row.id, "failed", make_problem(500, detail, title="Job given up"))


def cancel_all(connection: Connection, resources: Sequence[str], moment: datetime) -> None:
    """Ask for the jobs of resources to be stopped; those that have not begun end at once, those that ended stay."""
    ended = list(connection.execute(_CANCEL_QUEUED, {"resources": resources, "moment": moment}).scalars())
    # What another service took meanwhile runs by now.
    connection.execute(_CANCEL_RUNNING, {"resources": resources})
    connection.execute(_FORGET_ALL, {"jobs": ended})
    _say(connection, ended, {"state": "cancelled"})


def end(session: Session, job_id: str, state: State, problem: Problem | None = None) -> None:
    """End a job; what it had reached is needed no more."""
    connection = session.connection()
    error = None if problem is None else problem.model_dump(exclude_none=True)
    connection.execute(_FORGET, {"job": job_id})
    connection.execute(_END, {"job": job_id, "ended": state, "moment": clock(session), "problem": error})
    _say(connection, [job_id], {"state": state} if error is None else {"state": state, "error": error})


def _say(connection: Connection, job_ids: Sequence[str], data: Mapping[str, Any], event: str = "state") -> None:
    if job_ids:
        connection.execute(_ADD_EVENTS, [{"job_id": one, "event": event, "data": data} for one in job_ids])


def _claim(row: Row[Any]) -> Claim:
    arguments = dict(row.arguments)
    request_id, trace = arguments.pop(REQUEST, None), arguments.pop(TRACE, None)
    return Claim(row.id, row.attempt, row.function, arguments, row.resource_id, request_id, trace)
