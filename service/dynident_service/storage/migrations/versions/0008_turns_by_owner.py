"""The next job is one of the owner of whom the fewest run: found by an index, however many are queued."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"

OWNED = sa.text("owner IS NOT NULL")


def upgrade() -> None:
    """Apply."""
    op.create_index("ix_jobs_state_owner_id", "jobs", ["state", "owner", "id"])
    op.drop_index("ix_jobs_owner_state", "jobs")
