"""Revisions of shapes: the revision that changed or removed each, so that a cache reads only later changes."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

OLD_STATE = "One row; revision counts changes to shapes other than additions, so that caches know."
NEW_STATE = "One row; revision counts changes to shapes, so that caches know."
OLD_SHAPES = "The library's members. seq never comes again, so that pages and the search index can rely on it."
NEW_SHAPES = (
    "The library's members. seq never comes again, so that pages and the search index can rely on it; "
    "changed is the revision that last changed a row since it was added."
)


def upgrade() -> None:
    # Not in a batch, which would recreate the table: slow for a large one, and SQLite would lose the last seq.
    op.add_column("shapes", sa.Column("changed", sa.Integer(), nullable=False, server_default="0"))
    op.create_index(op.f("ix_shapes_changed"), "shapes", ["changed"])
    op.create_table(
        "removals",
        sa.Column("seq", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("seq", name=op.f("pk_removals")),
        comment="Shapes that are gone, and the revision that removed them.",
    )
    op.create_index(op.f("ix_removals_revision"), "removals", ["revision"])
    comment("shapes", NEW_SHAPES, OLD_SHAPES)
    comment("library_state", NEW_STATE, OLD_STATE)


def downgrade() -> None:
    comment("library_state", OLD_STATE, NEW_STATE)
    comment("shapes", OLD_SHAPES, NEW_SHAPES)
    op.drop_table("removals")
    op.drop_index(op.f("ix_shapes_changed"), "shapes")
    op.drop_column("shapes", "changed")


def comment(table: str, new: str, old: str) -> None:
    if op.get_context().dialect.supports_comments:
        op.create_table_comment(table, new, existing_comment=old)
