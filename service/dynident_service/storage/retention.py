"""Deletion of data that expires: events of jobs that ended long ago, retry keys, unused imports."""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import delete, func, select

from dynident_service.storage.database import Database, get_database_time
from dynident_service.storage.tables import DependencyRow, JobEventRow, JobRow, ObjectRow, ResourceRow, RetryRow
from dynident_service.storage.tombstones import raise_tombstones

IMPORT_LIFETIME = 24 * 3600.0
"""Seconds after which an unused import is deleted."""
AT_ONCE = 200
"""Imports, or jobs with their events, that one transaction deletes, so that other writers do not wait long."""


def delete_expired(database: Database, age: timedelta) -> int:
    """Delete retry keys and events of jobs that ended more than `age` ago.

    The last event of each job stays, as it says how the job ended.

    Returns
    -------
    int
        Number of jobs whose events were deleted.
    """
    with database.write() as session:
        session.execute(delete(RetryRow).where(RetryRow.created_at < get_database_time(session) - age))
    forgotten = 0
    # Transaction by transaction: others can write in between.
    while number := _delete_events(database, age):
        forgotten += number
    return forgotten


def _delete_events(database: Database, age: timedelta) -> int:
    with database.write() as session:
        old = (
            select(JobEventRow.job_id, func.max(JobEventRow.id))
            .join(JobRow, JobRow.id == JobEventRow.job_id)
            .where(JobRow.finished_at < get_database_time(session) - age)
            .group_by(JobEventRow.job_id)
            .having(func.count() > 1)
            .limit(AT_ONCE)
        )
        jobs = session.execute(old).all()
        for job_id, last in jobs:
            session.execute(delete(JobEventRow).where(JobEventRow.job_id == job_id, JobEventRow.id < last))
    return len(jobs)


def delete_unused_imports(database: Database, age: timedelta) -> int:
    """Delete the imports older than `age` on which nothing depends, at most `AT_ONCE`; return their number."""
    with database.write() as session:
        used = select(DependencyRow.on_id).where(DependencyRow.on_id == ResourceRow.id).exists()
        old = session.scalars(
            select(ResourceRow)
            .where(ResourceRow.kind == "import", ResourceRow.created_at < get_database_time(session) - age, ~used)
            .limit(AT_ONCE)
        ).all()
        for row in old:
            raise_tombstones(session, session.scalars(select(ObjectRow.key).where(ObjectRow.resource_id == row.id)))
            session.delete(row)
        return len(old)
