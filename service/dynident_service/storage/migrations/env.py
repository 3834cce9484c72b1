"""Runs the migrations on the connection that `migrate` gives."""

from __future__ import annotations

from alembic import context

from dynident_service.storage.database_tables import Table

connection = context.config.attributes["connection"]
context.configure(connection=connection, target_metadata=Table.metadata)
with context.begin_transaction():
    context.run_migrations()
