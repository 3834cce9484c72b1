"""Keys say what they allow, to whom and until when; those that there are allow everything, as before."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Apply."""
    op.add_column("api_keys", sa.Column("scope", sa.String(10), nullable=False, server_default="admin"))
    op.add_column("api_keys", sa.Column("owner", sa.String(200), nullable=True))
    op.add_column("api_keys", sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("api_keys", sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=True))
