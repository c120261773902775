"""Epochs: a restored library gets a new one, because caches must not compare its revisions with earlier ones."""

import uuid

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

OLD = "One row; revision counts changes to shapes, so that caches know."
NEW = "One row; revision counts changes to shapes within an epoch, which a restore begins, so that caches know."


def upgrade() -> None:
    op.add_column("library_state", sa.Column("epoch", sa.String(length=32), nullable=False, server_default="0"))
    state = sa.table("library_state", sa.column("epoch", sa.String()))
    op.execute(state.update().values(epoch=uuid.uuid4().hex))
    comment(NEW, OLD)


def downgrade() -> None:
    comment(OLD, NEW)
    op.drop_column("library_state", "epoch")


def comment(new: str, old: str) -> None:
    if op.get_context().dialect.supports_comments:
        op.create_table_comment("library_state", new, existing_comment=old)
