"""Imports are kept for a day, unless a measurement rests on them."""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import select

from dynident_service.storage.database import Database, clock
from dynident_service.storage.tables import DependencyRow, ObjectRow, ResourceRow
from dynident_service.storage.tombstones import announce

KEPT = 24 * 3600.0
"""Seconds that an import is kept which nobody uses."""

_AT_ONCE = 200


def forget_imports(database: Database, kept: timedelta) -> int:
    """Delete the imports that are older and that nothing rests on; tells how many."""
    with database.write() as session:
        used = select(DependencyRow.on_id).where(DependencyRow.on_id == ResourceRow.id).exists()
        old = session.scalars(
            select(ResourceRow)
            .where(ResourceRow.kind == "import", ResourceRow.created_at < clock(session) - kept, ~used)
            .limit(_AT_ONCE)
        ).all()
        for row in old:
            announce(session, session.scalars(select(ObjectRow.key).where(ObjectRow.resource_id == row.id)))
            session.delete(row)
        return len(old)
