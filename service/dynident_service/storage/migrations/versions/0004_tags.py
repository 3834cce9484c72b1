"""Resources have tags, and may be archived."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Apply."""
    op.add_column("resources", sa.Column("tags", sa.JSON(), nullable=False, server_default="[]"))
    op.add_column("resources", sa.Column("archived", sa.Boolean(), nullable=False, server_default=sa.false()))
