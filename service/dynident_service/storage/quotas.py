"""Quotas of an API key: what it stores and computes, and the check before a row is added.

A request acts for an account, which is the name of its key; without keys there is no account, and nothing is counted.
The use of an account is summed over its own rows through an index, and only if it has a limit. A transaction that adds
to an account holds the account's lock until it is committed, so that two at once cannot both take the last room. The
lock is the single writer of SQLite, and an advisory lock on PostgreSQL.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from contextvars import ContextVar
from dataclasses import astuple, dataclass
from typing import Any

from sqlalchemy import Select, bindparam, func, select
from sqlalchemy.orm import Session

from dynident_service.problems import ProblemError
from dynident_service.storage.database_tables import JOBS, OBJECTS, RESOURCES
from dynident_service.storage.repository_values import NewResource, OwnedObject

SENT = ("measurement", "import", "robot")
"""Kinds of resources whose files are uploaded and not computed: recordings, and meshes."""
UNFINISHED = ("queued", "running")
_OWNER = "owner"


@dataclass(frozen=True)
class QuotaLimits:
    """Upper limits for an account: 0 means no limit, None means that it is not set."""

    bytes: int | None = None
    recordings: int | None = None
    jobs: int | None = None

    def fill_from(self, others: QuotaLimits) -> QuotaLimits:
        """Return these limits, with those of `others` where none is set here."""
        pairs = zip(astuple(self), astuple(others), strict=True)
        # Only what is not set gives way: 0 says that there is no limit, and stands.
        return QuotaLimits(*(theirs if mine is None else mine for mine, theirs in pairs))


UNLIMITED = QuotaLimits()


@dataclass(frozen=True)
class Account:
    """Account that a request acts for, and its limits."""

    name: str
    limits: QuotaLimits = UNLIMITED


@dataclass(frozen=True)
class Usage:
    """What an account uses now."""

    bytes: int = 0
    """Bytes of uploaded and simulated files; each file counts once, however many resources own it."""
    recordings: int = 0
    """Number of measurements and of unfinished simulations, each of which will create a measurement."""
    jobs: int = 0
    """Number of jobs that are queued or running."""


class QuotaExceeded(ProblemError):
    """The account would exceed one of its limits."""

    retry_after = "5"


_acting: ContextVar[Account | None] = ContextVar("dynident_account", default=None)


def set_account(account: Account | None) -> None:
    """Set the account that the current request acts for, in this task and in the tasks that it starts."""
    _acting.set(account)


def get_account() -> Account | None:
    """Return the account that the current request acts for; None if no key was required, and in jobs."""
    return _acting.get()


_OWNED = (
    select(RESOURCES.c.owner, OBJECTS.c.key, OBJECTS.c.size)
    .join(RESOURCES, RESOURCES.c.id == OBJECTS.c.resource_id)
    .where(RESOURCES.c.kind.in_(SENT))
    .distinct()
)
"""Uploaded files by owner; each counts once, however many resources of the owner have it."""
_OF_ONE = _OWNED.where(RESOURCES.c.owner == bindparam(_OWNER))
_BYTES = select(func.coalesce(func.sum(_OF_ONE.subquery().c.size), 0))
_HAS = _OF_ONE.where(OBJECTS.c.key.in_(bindparam("keys", expanding=True))).with_only_columns(OBJECTS.c.key)
_MEASUREMENTS = select(func.count()).where(RESOURCES.c.owner == bindparam(_OWNER), RESOURCES.c.kind == "measurement")
_JOBS = select(func.count()).where(JOBS.c.owner == bindparam(_OWNER), JOBS.c.state.in_(UNFINISHED))
_SIMULATIONS = _JOBS.where(JOBS.c.kind == "simulation")


def sum_bytes(session: Session, name: str) -> int:
    """Return the bytes of all files of an account."""
    return _run_count(session, _BYTES, name)


def compute_usage(session: Session, name: str) -> Usage:
    """Return what an account uses."""
    return Usage(sum_bytes(session, name), _count_recordings(session, name), _run_count(session, _JOBS, name))


def compute_all_usage(session: Session) -> dict[str | None, Usage]:
    """Return what every account uses, by its name; None stands for resources without an owner. Reads all rows."""
    files = _OWNED.subquery()
    unfinished = select(JOBS.c.owner, func.count()).where(JOBS.c.state.in_(UNFINISHED)).group_by(JOBS.c.owner)
    queries: tuple[Select[Any], ...] = (
        select(files.c.owner, func.sum(files.c.size)).group_by(files.c.owner),
        select(RESOURCES.c.owner, func.count()).where(RESOURCES.c.kind == "measurement").group_by(RESOURCES.c.owner),
        unfinished.where(JOBS.c.kind == "simulation"),
        unfinished,
    )
    size, measured, simulated, jobs = ({name: int(n) for name, n in session.execute(query)} for query in queries)
    names = size.keys() | measured.keys() | jobs.keys()
    return {
        name: Usage(size.get(name, 0), measured.get(name, 0) + simulated.get(name, 0), jobs.get(name, 0))
        for name in names
    }


def lock_account(session: Session, account: Account | None) -> None:
    """Lock an account until the end of the transaction, if it has a limit, so that no other one adds to it."""
    # SQLite has one writer at a time: its transactions wait for one another anyway.
    if account is None or not any(astuple(account.limits)) or session.get_bind().dialect.name == "sqlite":
        return
    # PostgreSQL numbers advisory locks by 64 bits; the hash spreads the names over them.
    digest = hashlib.sha256(f"quota of {account.name}".encode()).digest()
    session.execute(select(func.pg_advisory_xact_lock(int.from_bytes(digest[:8], "big", signed=True))))


def check_quota(session: Session, account: Account | None, several: Sequence[NewResource]) -> None:
    """Check that an account may have further resources; does nothing if it has no limit.

    Raise `QuotaExceeded` if a limit would be exceeded.
    """
    if account is None:
        return
    # Each count is a query: only limits that are set, and that these resources touch, are looked at.
    jobs = sum(new.job is not None for new in several)
    if account.limits.jobs and jobs:
        _check_jobs(account, _run_count(session, _JOBS, account.name), jobs)
    recordings = sum(new.kind in ("measurement", "simulation") for new in several)
    if account.limits.recordings and recordings:
        _check_recordings(account, _count_recordings(session, account.name), recordings)
    to_come = any(new.kind == "simulation" for new in several)
    owned = [owned_object for new in several if new.kind in SENT for owned_object in new.objects]
    check_byte_quota(session, account, owned, at_least=1 if to_come else 0)


def check_byte_quota(
    session: Session, account: Account | None, owned: Iterable[OwnedObject], at_least: int = 0
) -> None:
    """Check that an account may have further files.

    Raise `QuotaExceeded` if not. Files that the account has already take no room; `at_least` stands for files whose
    size is not known yet.
    """
    new = {owned_object.key: owned_object.size for owned_object in owned}
    if account is None or not account.limits.bytes or not (new or at_least):
        return
    # A file that the account owns already is stored only once, and takes no further room.
    known = session.scalars(_HAS, {_OWNER: account.name, "keys": list(new)}) if new else ()
    for key in known:
        new.pop(key)
    # The size of a simulated recording is known only at its end: until then it counts as one byte, so that a full
    # account starts none.
    more = max(at_least, sum(new.values()))
    used = sum_bytes(session, account.name)
    if more and used + more > account.limits.bytes:
        raise make_bytes_error(account, account.limits.bytes, used, more)


def make_bytes_error(account: Account, allowed: int, used: int, more: int) -> QuotaExceeded:
    """Return the error for files that exceed an account's limit."""
    return _make_storage_error(
        f"The key {account.name!r} stores {used} bytes of files; its limit is {allowed} (DYNIDENT_QUOTA_BYTES, or "
        f"its own). This request would add {more}, so nothing was stored."
    )


def _check_recordings(account: Account, used: int, more: int) -> None:
    allowed = account.limits.recordings or 0
    if used + more > allowed:
        raise _make_storage_error(
            f"The key {account.name!r} stores {used} recordings; its limit is {allowed} "
            "(DYNIDENT_QUOTA_RECORDINGS, or its own), so nothing was stored."
        )


def _check_jobs(account: Account, used: int, more: int) -> None:
    allowed = account.limits.jobs or 0
    if used + more <= allowed:
        return
    # More than the limit at once is never accepted, however long one waits.
    help_ = "wait until some have ended, or cancel some" if more <= allowed else "send fewer at a time"
    detail = (
        f"The key {account.name!r} has {used} jobs queued or running; its limit is {allowed} "
        f"(DYNIDENT_QUOTA_JOBS, or its own). This request needs {more} more: {help_}. Nothing was accepted."
    )
    # 429: the same request succeeds once jobs have ended. For storage it is 507, as room has to be made first.
    raise QuotaExceeded(429, detail, title="Quota of jobs used up")


def _make_storage_error(detail: str) -> QuotaExceeded:
    help_ = "Delete measurements and imports that you no longer need; this frees space at once (GET /v1/usage)."
    return QuotaExceeded(507, f"{detail} {help_}", title="Quota of storage used up")


def _count_recordings(session: Session, name: str) -> int:
    return _run_count(session, _MEASUREMENTS, name) + _run_count(session, _SIMULATIONS, name)


def _run_count(session: Session, query: Select[Any], name: str) -> int:
    return int(session.execute(query, {_OWNER: name}).scalar_one())
