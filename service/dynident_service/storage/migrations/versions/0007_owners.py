"""Resources and jobs know the key that sent them, and keys may have quotas; what there is already belongs to nobody."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"

OWNED = sa.text("owner IS NOT NULL")
QUOTAS = ("quota_bytes", "quota_recordings", "quota_jobs")


def upgrade() -> None:
    """Apply."""
    for table, column in (("resources", "kind"), ("jobs", "state")):
        op.add_column(table, sa.Column("owner", sa.String(200), nullable=True))
        op.create_index(
            f"ix_{table}_owner_{column}", table, ["owner", column], sqlite_where=OWNED, postgresql_where=OWNED
        )
    for name in QUOTAS:
        op.add_column("api_keys", sa.Column(name, sa.BigInteger(), nullable=True))
