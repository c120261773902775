"""Tickets of a cluster's queue. PostgreSQL also gets the buckets of callers, and files that it can read in ranges."""

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
    if op.get_context().dialect.name == "postgresql":
        store_files("EXTERNAL")  # PostgreSQL reads a compressed value whole
        for table, column in (("jobs", "seq"), ("job_files", "job_seq")):
            op.alter_column(table, column, type_=sa.BigInteger())
        op.execute("ALTER SEQUENCE jobs_seq_seq AS bigint")
        op.create_table(
            "request_rates",
            sa.Column("caller", sa.String(), nullable=False),
            sa.Column("tokens", sa.Float(), nullable=False),
            sa.Column("at", sa.TIMESTAMP(timezone=True), nullable=False),
            sa.PrimaryKeyConstraint("caller", name=op.f("pk_request_rates")),
            comment="Tokens of callers, for the limit on requests.",
            prefixes=["UNLOGGED"],  # a crash may forget them
        )


def downgrade() -> None:
    if op.get_context().dialect.name == "postgresql":
        op.drop_table("request_rates")
        op.execute("ALTER SEQUENCE jobs_seq_seq AS integer")
        for table, column in (("jobs", "seq"), ("job_files", "job_seq")):
            op.alter_column(table, column, type_=sa.Integer())
        store_files("EXTENDED")
    comment(OLD, NEW)
    op.drop_column("jobs", "ticket")


def comment(new: str, old: str) -> None:
    if op.get_context().dialect.supports_comments:
        op.create_table_comment("jobs", new, existing_comment=old)


def store_files(storage: str) -> None:
    for table in ("meshes", "job_files"):
        op.execute(f"ALTER TABLE {table} ALTER COLUMN data SET STORAGE {storage}")
