"""Smoothing: adds "smooth":0 to earlier policies, because a policy's JSON text is part of a signature's key."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

TABLES = [sa.table(name, sa.column("policy", sa.String())) for name in ("signatures", "jobs")]
END = ',"smooth":0}'  # canonical JSON is in the order of names


def upgrade() -> None:
    for table in TABLES:
        silent = ~table.c.policy.contains('"smooth":', autoescape=True)
        op.execute(table.update().where(silent).values(policy=without_end(table, "}") + END))


def downgrade() -> None:
    # A smoothed shape keeps its policy, because no earlier policy describes it.
    for table in TABLES:
        unsmoothed = table.c.policy.endswith(END, autoescape=True)
        op.execute(table.update().where(unsmoothed).values(policy=without_end(table, END) + "}"))


def without_end(table: sa.TableClause, end: str) -> sa.ColumnElement[str]:
    return sa.func.substr(table.c.policy, 1, sa.func.length(table.c.policy) - len(end), type_=sa.String())
