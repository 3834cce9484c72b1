"""The connection to the database: SQLite in one file by default, PostgreSQL by URL."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, cast

from sqlalchemy import Connection, Engine, create_engine, event, func, make_url, select, text
from sqlalchemy.orm import Session

WRITES = "dynident_writes"
BUSY_TIMEOUT_MS = 15_000
CONNECT_TIMEOUT = 5
"""Seconds."""
POOL = 24
"""Connections to an SQLite file that are kept: one more than these is opened and set up for each transaction anew."""
AT_ONCE = 500
"""So many are asked for by one query."""


class Database:
    """Gives sessions for reading and for writing.

    On SQLite a writing transaction begins with `BEGIN IMMEDIATE`: a transaction that began by reading could not be
    promoted once another process has written, whatever the busy timeout.

    A reading session sees one moment of the database, however many statements it takes: by itself on SQLite, by
    `REPEATABLE READ` on PostgreSQL. Who wants to see what others wrote meanwhile opens another.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.is_sqlite = make_url(url).get_backend_name() == "sqlite"
        self.engine = _sqlite_engine(url) if self.is_sqlite else _postgresql_engine(url)
        self._writer = self.engine.execution_options(**{WRITES: True})
        one_moment: dict[str, Any] = {} if self.is_sqlite else {"isolation_level": "REPEATABLE READ"}
        self._reader = self.engine.execution_options(**one_moment)
        self._turn: AbstractContextManager[object] = _turn_of(url) if self.is_sqlite else nullcontext()

    @contextmanager
    def read(self) -> Iterator[Session]:
        """Open a session that only reads, all as it is at its first statement."""
        with Session(self._reader, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def one_moment(self) -> Iterator[Connection]:
        """Open a connection that only reads, as `read`."""
        with self._reader.connect() as connection, connection.begin():
            yield connection

    @contextmanager
    def write(self) -> Iterator[Session]:
        """Open a session that is committed at the end, or rolled back by an exception."""
        with self._turn, Session(self._writer, expire_on_commit=False) as session, session.begin():
            yield session

    def ping(self) -> None:
        """Raise unless the database answers."""
        with self.engine.connect() as connection:
            connection.execute(text("SELECT 1"))

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()


@cache
def _turn_of(url: str) -> threading.Lock:
    """The lock by which the threads of a process take turns to write to an SQLite file.

    SQLite itself makes a writer that finds another one sleep for up to 0.1 s, again and again.
    """
    return threading.Lock()


def clock(session: Session) -> datetime:
    """Give the time by the clock that all who share the database agree on: its own (SQLite runs on this machine)."""
    if session.get_bind().dialect.name == "sqlite":
        return datetime.now(UTC)
    told = session.execute(select(func.clock_timestamp())).scalar_one()
    return cast(datetime, told).astimezone(UTC)


def _sqlite_engine(url: str) -> Engine:
    database = make_url(url).database
    if database and database != ":memory:":
        Path(database).parent.mkdir(parents=True, exist_ok=True)
    engine = create_engine(
        url, pool_size=POOL, connect_args={"check_same_thread": False, "timeout": BUSY_TIMEOUT_MS / 1000}
    )

    @event.listens_for(engine, "connect")
    def configure(connection: Any, _: Any) -> None:
        connection.isolation_level = None  # the driver would begin transactions in its own way
        for pragma in (
            "journal_mode = WAL",
            "synchronous = NORMAL",
            "foreign_keys = ON",
            f"busy_timeout = {BUSY_TIMEOUT_MS}",
        ):
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get(WRITES, False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def _postgresql_engine(url: str) -> Engine:
    engine = create_engine(
        url, pool_pre_ping=True, isolation_level="READ COMMITTED", connect_args={"connect_timeout": CONNECT_TIMEOUT}
    )

    @event.listens_for(engine, "connect")
    def configure(connection: Any, _: Any) -> None:
        # Not as an option of the connection: poolers that stand between refuse those.
        connection.execute(f"SET lock_timeout = {BUSY_TIMEOUT_MS}")
        connection.commit()

    return engine
