"""What is forgotten after a while: the course of jobs that ended long ago, keys of retries, unused imports."""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import delete, func, select

from dynident_service.storage.database import Database, clock
from dynident_service.storage.tables import DependencyRow, JobEventRow, JobRow, ObjectRow, ResourceRow, RetryRow
from dynident_service.storage.tombstones import announce

KEPT = 24 * 3600.0
"""Seconds that an import is kept which nobody uses."""
AT_ONCE = 200
"""Imports, or jobs whose events, are deleted in one transaction, so that nobody waits long for the next."""


def forget(database: Database, kept: timedelta) -> int:
    """Delete what is older; of a job's events the last stays, which says how it ended. Tells how many jobs."""
    with database.write() as session:
        session.execute(delete(RetryRow).where(RetryRow.created_at < clock(session) - kept))
    forgotten = 0
    while number := _forget_events(database, kept):
        forgotten += number
    return forgotten


def _forget_events(database: Database, kept: timedelta) -> int:
    with database.write() as session:
        old = (
            select(JobEventRow.job_id, func.max(JobEventRow.id))
            .join(JobRow, JobRow.id == JobEventRow.job_id)
            .where(JobRow.finished_at < clock(session) - kept)
            .group_by(JobEventRow.job_id)
            .having(func.count() > 1)
            .limit(AT_ONCE)
        )
        jobs = session.execute(old).all()
        for job_id, last in jobs:
            session.execute(delete(JobEventRow).where(JobEventRow.job_id == job_id, JobEventRow.id < last))
    return len(jobs)


def forget_imports(database: Database, kept: timedelta) -> int:
    """Delete the imports that are older and that nothing rests on; tells how many."""
    with database.write() as session:
        used = select(DependencyRow.on_id).where(DependencyRow.on_id == ResourceRow.id).exists()
        old = session.scalars(
            select(ResourceRow)
            .where(ResourceRow.kind == "import", ResourceRow.created_at < clock(session) - kept, ~used)
            .limit(AT_ONCE)
        ).all()
        for row in old:
            announce(session, session.scalars(select(ObjectRow.key).where(ObjectRow.resource_id == row.id)))
            session.delete(row)
        return len(old)
