"""Objects are let go of by a tombstone, and swept away later."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Apply."""
    op.create_table(
        "tombstones",
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("since", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("key", name="pk_tombstones"),
    )
    op.create_index("ix_tombstones_since", "tombstones", ["since"], unique=False)


def downgrade() -> None:
    """Take back."""
    op.drop_index("ix_tombstones_since", table_name="tombstones")
    op.drop_table("tombstones")
