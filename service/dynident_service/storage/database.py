"""Connect to SQLite or PostgreSQL (timeouts, pool), migrate its tables, repeat calls while it or the store is away."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

from obstore.exceptions import BaseError
from sqlalchemy import Connection, Engine, create_engine, event, func, make_url, select, text
from sqlalchemy.exc import InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as NoConnection
from sqlalchemy.orm import Session

from dynident_service.storage.object_store import ObjectGone

if TYPE_CHECKING:
    from alembic.config import Config


WRITES = "dynident_writes"
"""Execution option that marks a connection on which transactions write."""
BUSY_TIMEOUT_MS = 15_000
"""Milliseconds that a statement waits for a lock."""
CONNECT_TIMEOUT = 5
"""Seconds to connect to PostgreSQL."""
POOL = 24
"""Open connections that are kept to an SQLite file; each further one is opened and configured for every transaction."""
AT_ONCE = 500
"""Upper limit for the ids in one query."""


class Database:
    """Database of the service, with sessions for reading and for writing.

    On SQLite a writing transaction begins with `BEGIN IMMEDIATE`: a transaction that began by reading cannot be
    promoted once another process has written, whatever the busy timeout.

    A reading session sees one snapshot of the database, however many statements it takes: SQLite does so by itself,
    PostgreSQL by `REPEATABLE READ`. To see later changes, open another session.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.is_sqlite = make_url(url).get_backend_name() == "sqlite"
        self.engine = _create_sqlite_engine(url) if self.is_sqlite else _create_postgresql_engine(url)
        self._writer = self.engine.execution_options(**{WRITES: True})
        one_moment: dict[str, Any] = {} if self.is_sqlite else {"isolation_level": "REPEATABLE READ"}
        self._reader = self.engine.execution_options(**one_moment)
        self._turn: AbstractContextManager[object] = _get_write_lock(url) if self.is_sqlite else nullcontext()

    @contextmanager
    def read(self) -> Iterator[Session]:
        """Open a read-only session; it sees the database as of its first statement."""
        with Session(self._reader, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def open_snapshot(self) -> Iterator[Connection]:
        """Open a read-only connection that sees one snapshot, like `read`."""
        with self._reader.connect() as connection, connection.begin():
            yield connection

    @contextmanager
    def write(self) -> Iterator[Session]:
        """Open a session that is committed at the end, or rolled back by an exception."""
        with self._turn, Session(self._writer, expire_on_commit=False) as session, session.begin():
            yield session

    def ping(self) -> None:
        """Raise an exception unless the database answers."""
        with self.engine.connect() as connection:
            connection.execute(text("SELECT 1"))

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()


@cache
def _get_write_lock(_url: str) -> threading.Lock:
    """Return the lock of a URL that the threads of this process take before they write to its SQLite file.

    Without it a writer that meets another one sleeps inside SQLite for up to 0.1 s, again and again.
    """
    return threading.Lock()


def get_database_time(session: Session) -> datetime:
    """Return the current time by the clock that all services of a database agree on, which is the database's own."""
    # An SQLite file has no server; all its users run on this machine.
    if session.get_bind().dialect.name == "sqlite":
        return datetime.now(UTC)
    moment = session.execute(select(func.clock_timestamp())).scalar_one()
    return cast(datetime, moment).astimezone(UTC)


def _create_sqlite_engine(url: str) -> Engine:
    database = make_url(url).database
    if database and database != ":memory:":
        Path(database).parent.mkdir(parents=True, exist_ok=True)
    engine = create_engine(
        url, pool_size=POOL, connect_args={"check_same_thread": False, "timeout": BUSY_TIMEOUT_MS / 1000}
    )

    @event.listens_for(engine, "connect")
    def configure(connection: Any, _: Any) -> None:
        connection.isolation_level = None  # the driver would begin transactions in its own way
        # WAL lets readers read while one writes; NORMAL then loses at most the last transactions at a power cut, and
        # never the file.
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


def _create_postgresql_engine(url: str) -> Engine:
    engine = create_engine(
        url, pool_pre_ping=True, isolation_level="READ COMMITTED", connect_args={"connect_timeout": CONNECT_TIMEOUT}
    )

    @event.listens_for(engine, "connect")
    def configure(connection: Any, _: Any) -> None:
        # Not as an option of the connection: poolers that stand between refuse those.
        connection.execute(f"SET lock_timeout = {BUSY_TIMEOUT_MS}")
        connection.commit()

    return engine


POSTGRESQL_LOCK = 7_311_949_283_041
"""Number of the advisory lock under which migrations run; any fixed number will do."""


def migrate(database: Database) -> None:
    """Apply the missing migrations; safe when several processes start at once."""
    # Only processes that migrate load Alembic.
    from alembic import command

    engine = database.engine.execution_options(**{WRITES: True})
    with engine.connect() as connection, connection.begin():
        # On SQLite the transaction is the only writer from its beginning; PostgreSQL needs a lock of its own.
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": POSTGRESQL_LOCK})
        # All migrations are one transaction: if one fails, the database stays as it was.
        command.upgrade(build_alembic_config(connection), "head")


def build_alembic_config(connection: Connection) -> Config:
    """Return Alembic's configuration for the migrations of this package."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    return config


T = TypeVar("T")

AWAY = (OperationalError, InterfaceError, NoConnection, BaseError)
"""Exceptions of a database that is away or locked, and of a store that does not answer."""
INFRASTRUCTURE_ERRORS = (*AWAY, ObjectGone)
"""Exceptions that are no fault of a computation, which is therefore repeated."""
FIRST_PAUSE = 0.1
LONGEST_PAUSE = 5.0
log = logging.getLogger("dynident.storage")


def retry_while_away(action: Callable[[], T], patience: float) -> T:
    """Repeat an action while the database or the store is away.

    After `patience` seconds the last exception is raised.
    """
    until, pause = time.monotonic() + patience, FIRST_PAUSE
    while True:
        try:
            return action()
        except AWAY as error:
            if time.monotonic() + pause > until:
                raise
            log.warning("%s; trying again", describe_error(error))
        time.sleep(pause)
        # Pauses grow, so that many workers do not press a server that is just starting.
        pause = min(2 * pause, LONGEST_PAUSE)


def describe_error(error: BaseException) -> str:
    """Return an exception in one line, without SQL statements and parameters, which may hold user data."""
    inner = getattr(error, "orig", None) or error
    # The lines behind it are the statement and its parameters.
    first_line = (str(inner).splitlines() or [""])[0]
    return f"{type(inner).__name__}: {first_line}"[:200]
