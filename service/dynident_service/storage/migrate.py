"""Migration of the database to the tables of this version."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, text

from dynident_service.storage.database import WRITES, Database

POSTGRESQL_LOCK = 7_311_949_283_041
"""Number of the advisory lock under which migrations run; any fixed number will do."""


def migrate(database: Database) -> None:
    """Apply the missing migrations; safe when several processes start at once."""
    engine = database.engine.execution_options(**{WRITES: True})
    with engine.connect() as connection, connection.begin():
        # On SQLite the transaction is the only writer from its beginning; PostgreSQL needs a lock of its own.
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": POSTGRESQL_LOCK})
        # All migrations are one transaction: if one fails, the database stays as it was.
        command.upgrade(build_alembic_config(connection), "head")


def build_alembic_config(connection: Connection) -> Config:
    """Return Alembic's configuration for the migrations of this package."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    return config
