"""Tickets of a cluster's queue; PostgreSQL stores files uncompressed, so that it can read ranges of them."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

OLD = "The queue and its history."
NEW = "The queue and its history. ticket is the delivery of a cluster's queue by which a worker claimed the job."


def upgrade() -> None:
    op.add_column("jobs", sa.Column("ticket", sa.BigInteger()))
    comment(NEW, OLD)
    store_files("EXTERNAL")


def downgrade() -> None:
    store_files("EXTENDED")
    comment(OLD, NEW)
    op.drop_column("jobs", "ticket")


def comment(new: str, old: str) -> None:
    if op.get_context().dialect.supports_comments:
        op.create_table_comment("jobs", new, existing_comment=old)


def store_files(storage: str) -> None:
    if op.get_context().dialect.name == "postgresql":
        for table in ("meshes", "job_files"):
            op.execute(f"ALTER TABLE {table} ALTER COLUMN data SET STORAGE {storage}")
