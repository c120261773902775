"""Seams and warnings: earlier meshes were read without stitching, and their policies record that; no warnings."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

SIGNATURES = sa.table("signatures", sa.column("policy", sa.String()), sa.column("report", sa.JSON()))
JOBS = sa.table("jobs", sa.column("policy", sa.String()), sa.column("file_type", sa.String()))
BEFORE, KEPT, STITCHED = (f'{text},"smooth":' for text in ("", ',"seams":"keep"', ',"seams":"stitch"'))


def upgrade() -> None:
    # stl files share no vertices, so they were welded; stitching is the closest policy.
    told = sa.cast(SIGNATURES.c.report, sa.String()).contains('"file_type": "stl"', autoescape=True)
    for table, welded in ((SIGNATURES, told), (JOBS, JOBS.c.file_type == "stl")):
        op.add_column(table.name, sa.Column("warnings", sa.JSON(), nullable=False, server_default="[]"))
        silent = ~table.c.policy.contains('"seams":', autoescape=True)
        seams = sa.case((welded, STITCHED), else_=KEPT)
        op.execute(table.update().where(silent).values(policy=sa.func.replace(table.c.policy, BEFORE, seams)))


def downgrade() -> None:
    # A stitched surface keeps its policy, because no earlier policy describes it.
    for table in (SIGNATURES, JOBS):
        op.execute(table.update().values(policy=sa.func.replace(table.c.policy, KEPT, BEFORE)))
        op.drop_column(table.name, "warnings")
