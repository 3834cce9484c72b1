"""Definitions of all database tables and their column types.

Every resource consists of a request, its result, the objects that it owns and its dependencies. One table therefore
holds the resources of all kinds, and deleting, listing and retrying work alike for all of them.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, cast

from sqlalchemy import (
    JSON,
    BigInteger,
    DateTime,
    Dialect,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    TypeDecorator,
    false,
)
from sqlalchemy import Table as Tables
from sqlalchemy import text as sql
from sqlalchemy.exc import DontWrapMixin
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from dynident_service.problems import ProblemError

NAMING = {
    "ix": "ix_%(column_0_label)s",
    "uq": "uq_%(table_name)s_%(column_0_name)s",
    "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
    "pk": "pk_%(table_name)s",
}


class UtcDateTime(TypeDecorator[datetime]):
    """Column type for times in UTC on every database; SQLite does not store the zone."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Convert to UTC for the database."""
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Convert to UTC from the database."""
        if value is None:
            return None
        # SQLite gives times without a zone, as it stores none: they are in UTC, as they were written.
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class UnusableText(ProblemError, DontWrapMixin):
    """A text that no supported database can store; not wrapped by SQLAlchemy, so that the user gets its message."""


class Text(TypeDecorator[str]):
    """Column type for texts without U+0000, which PostgreSQL cannot store; refused on every database alike."""

    impl = String
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: Dialect) -> str | None:
        """Raise UnusableText for a text that cannot be stored."""
        if value is not None:
            check_text(value)
        return value


def check_text(*texts: str) -> None:
    """Raise UnusableText for a text that no supported database can store."""
    for text in texts:
        if "\0" in text:
            raise UnusableText(422, f"{text[:80]!r} contains the character U+0000; remove it.", title="Unusable text")


def _index_by_owner(column: str, table: str) -> Index:
    """Return an index by owner. Rows without an owner are left out, so it costs nothing where no keys are used."""
    owned = sql("owner IS NOT NULL")
    return Index(f"ix_{table}_owner_{column}", "owner", column, sqlite_where=owned, postgresql_where=owned)


def get_utc_time() -> datetime:
    """Return the current time in UTC."""
    return datetime.now(UTC)


class Table(DeclarativeBase):
    """Base of all tables."""

    metadata = MetaData(naming_convention=NAMING)
    # None is stored as SQL's NULL, and not as the JSON text `null`, which no query for NULL would find.
    type_annotation_map = {datetime: UtcDateTime, dict[str, Any]: JSON(none_as_null=True)}  # noqa: RUF012


class ResourceRow(Table):
    """Resource of any kind: robot, measurement, identification, …, with its request and its result."""

    __tablename__ = "resources"

    id: Mapped[str] = mapped_column(Text(40), primary_key=True)
    kind: Mapped[str] = mapped_column(Text(20))
    name: Mapped[str | None] = mapped_column(Text(200))
    created_at: Mapped[datetime] = mapped_column(default=get_utc_time)
    request: Mapped[dict[str, Any]]
    result: Mapped[dict[str, Any] | None]
    tags: Mapped[list[str]] = mapped_column(JSON, default=list, server_default="[]")
    archived: Mapped[bool] = mapped_column(default=False, server_default=false())
    owner: Mapped[str | None] = mapped_column(Text(200))

    # Lists are of one kind, in the order of ids.
    __table_args__ = (Index("ix_resources_kind_id", "kind", "id"), _index_by_owner("kind", "resources"))


class DependencyRow(Table):
    """Dependency: `dependent_id` needs `on_id`, which therefore cannot be deleted."""

    __tablename__ = "dependencies"

    dependent_id: Mapped[str] = mapped_column(ForeignKey("resources.id", ondelete="CASCADE"), primary_key=True)
    on_id: Mapped[str] = mapped_column(ForeignKey("resources.id", ondelete="RESTRICT"), primary_key=True, index=True)
    role: Mapped[str] = mapped_column(Text(20), primary_key=True)


class ObjectRow(Table):
    """Object in the object store that a resource owns; several resources may own the same one."""

    __tablename__ = "objects"

    resource_id: Mapped[str] = mapped_column(ForeignKey("resources.id", ondelete="CASCADE"), primary_key=True)
    role: Mapped[str] = mapped_column(Text(20), primary_key=True)
    key: Mapped[str] = mapped_column(Text(64), index=True)
    size: Mapped[int] = mapped_column(BigInteger)
    media_type: Mapped[str] = mapped_column(Text(80))


class TombstoneRow(Table):
    """Object that may have no owner: a resource gave it up, or one is about to own it. The sweep checks it later."""

    __tablename__ = "tombstones"

    key: Mapped[str] = mapped_column(Text(64), primary_key=True)
    since: Mapped[datetime] = mapped_column(default=get_utc_time, index=True)


class JobRow(Table):
    """Job: a computation, its state, and who holds it until when."""

    __tablename__ = "jobs"

    id: Mapped[str] = mapped_column(Text(40), primary_key=True)
    kind: Mapped[str] = mapped_column(Text(20))
    resource_id: Mapped[str | None] = mapped_column(ForeignKey("resources.id", ondelete="CASCADE"), index=True)
    function: Mapped[str] = mapped_column(Text(120))
    arguments: Mapped[dict[str, Any]]
    state: Mapped[str] = mapped_column(Text(10), default="queued")
    fraction: Mapped[float] = mapped_column(Float, default=0.0)
    message: Mapped[str] = mapped_column(Text(300), default="")
    error: Mapped[dict[str, Any] | None]
    attempt: Mapped[int] = mapped_column(default=0)
    deaths: Mapped[int] = mapped_column(default=0)
    losses: Mapped[int] = mapped_column(default=0, server_default="0")
    lease_until: Mapped[datetime | None]
    cancel_requested: Mapped[bool] = mapped_column(default=False)
    created_at: Mapped[datetime] = mapped_column(default=get_utc_time)
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    owner: Mapped[str | None] = mapped_column(Text(200))

    __table_args__ = (
        Index("ix_jobs_state_id", "state", "id"),
        Index("ix_jobs_state_owner_id", "state", "owner", "id"),
    )


class CheckpointRow(Table):
    """Checkpoint of an unfinished job, from which its next attempt continues."""

    __tablename__ = "checkpoints"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    content: Mapped[bytes] = mapped_column(LargeBinary)


class JobEventRow(Table):
    """Event of a job, in order; `Last-Event-ID` names its id."""

    __tablename__ = "job_events"

    # SQLite numbers rows by itself only where the type of the column is exactly INTEGER.
    id: Mapped[int] = mapped_column(BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=True)
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), index=True)
    event: Mapped[str] = mapped_column(Text(10))
    data: Mapped[dict[str, Any]]


class RetryRow(Table):
    """`Idempotency-Key` that was used, and the resource that the request created."""

    __tablename__ = "retries"

    scope: Mapped[str] = mapped_column(Text(200), primary_key=True)
    key: Mapped[str] = mapped_column(Text(255), primary_key=True)
    fingerprint: Mapped[str] = mapped_column(Text(64))
    resource_id: Mapped[str] = mapped_column(ForeignKey("resources.id", ondelete="CASCADE"), index=True)
    created_at: Mapped[datetime] = mapped_column(default=get_utc_time)


class KeyRow(Table):
    """API key, as its SHA-256, with what it allows."""

    __tablename__ = "api_keys"

    sha256: Mapped[str] = mapped_column(Text(64), primary_key=True)
    name: Mapped[str] = mapped_column(Text(200))
    created_at: Mapped[datetime] = mapped_column(default=get_utc_time)
    scope: Mapped[str] = mapped_column(Text(10), default="admin", server_default="admin")
    owner: Mapped[str | None] = mapped_column(Text(200))
    expires_at: Mapped[datetime | None]
    last_used_at: Mapped[datetime | None]
    quota_bytes: Mapped[int | None] = mapped_column(BigInteger)
    quota_recordings: Mapped[int | None] = mapped_column(BigInteger)
    quota_jobs: Mapped[int | None] = mapped_column(BigInteger)


def get_table(rows: type[Table]) -> Tables:
    """Return the table of a row class, for statements without the ORM."""
    return cast(Tables, rows.__table__)


# For statements without the ORM, which takes several times as long over each.
RESOURCES, DEPENDENCIES, OBJECTS = get_table(ResourceRow), get_table(DependencyRow), get_table(ObjectRow)
JOBS, EVENTS, RETRIES = get_table(JobRow), get_table(JobEventRow), get_table(RetryRow)
CHECKPOINTS = get_table(CheckpointRow)
