"""Reading policies: earlier shapes were read with the default policy."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

DEFAULT = '{"components":"largest","max_vertices":null}'
OLD_KEY = ["mesh_sha256", "parameters", "version"]
NEW_KEY = ["mesh_sha256", "parameters", "policy", "version"]
OLD_COMMENT = "What was computed: one row for a file, parameters and version of the algorithm."
NEW_COMMENT = "What was computed: one row for a file, parameters, reading policy and version of the algorithm."
JOBS = {"sqlite_autoincrement": True}  # SQLite does not report it, so a recreated table would lose it


def upgrade() -> None:
    for table in ("signatures", "jobs"):
        op.add_column(table, sa.Column("policy", sa.String(), nullable=False, server_default=DEFAULT))
    with op.batch_alter_table("jobs", table_kwargs=JOBS) as batch_op:
        batch_op.alter_column("policy", server_default=None)
    with op.batch_alter_table("signatures") as batch_op:
        batch_op.alter_column("policy", server_default=None)
        batch_op.drop_constraint(name_of(OLD_KEY), type_="unique")
        batch_op.create_unique_constraint(name_of(NEW_KEY), NEW_KEY)
        batch_op.create_table_comment(NEW_COMMENT, existing_comment=OLD_COMMENT)


def downgrade() -> None:
    with op.batch_alter_table("signatures") as batch_op:
        batch_op.create_table_comment(OLD_COMMENT, existing_comment=NEW_COMMENT)
        batch_op.drop_constraint(name_of(NEW_KEY), type_="unique")
        batch_op.create_unique_constraint(name_of(OLD_KEY), OLD_KEY)
        batch_op.drop_column("policy")
    with op.batch_alter_table("jobs", table_kwargs=JOBS) as batch_op:
        batch_op.drop_column("policy")


def name_of(key: list[str]) -> str:
    return op.f("uq_signatures_" + "_".join(key))
