"""Meshes in an object store: their rows have no bytes; writes under way, and deletions that wait."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

OLD = "Uploaded files, byte for byte; one row however often a file is sent."
NEW = f"{OLD} data is null if the object store has it."


def upgrade() -> None:
    set_nullable("data BLOB NOT NULL", "data BLOB", nullable=True)
    comment(NEW, OLD)
    op.create_table(
        "object_writes",
        sa.Column("token", sa.String(32), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("at", sa.Float(), nullable=False),
        sa.PrimaryKeyConstraint("token", name=op.f("pk_object_writes")),
        comment="Objects that are written now; the transaction that needs an object removes its row.",
    )
    op.create_index(op.f("ix_object_writes_sha256"), "object_writes", ["sha256"])
    op.create_index(op.f("ix_object_writes_at"), "object_writes", ["at"])
    op.create_table(
        "object_deletions",
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("at", sa.Float(), nullable=False),
        sa.Column("claim", sa.String(32)),
        sa.Column("claimed_at", sa.Float()),
        sa.PrimaryKeyConstraint("sha256", name=op.f("pk_object_deletions")),
        comment="Objects that no mesh needs. A claimed deletion is carried out now, and no write of the object begins.",
    )


def downgrade() -> None:
    op.drop_table("object_deletions")
    op.drop_index(op.f("ix_object_writes_at"), "object_writes")
    op.drop_index(op.f("ix_object_writes_sha256"), "object_writes")
    op.drop_table("object_writes")
    comment(OLD, NEW)
    set_nullable("data BLOB", "data BLOB NOT NULL", nullable=False)


def set_nullable(old: str, new: str, *, nullable: bool) -> None:
    """Change the column without copying the meshes; SQLite then needs a change of the schema's text.

    The content of the file stays the same. SQLite describes this way in "Making Other Kinds Of Table Schema Changes".
    """
    if op.get_context().dialect.name != "sqlite":
        op.alter_column("meshes", "data", existing_type=sa.LargeBinary(), nullable=nullable)
        return
    connection = op.get_bind()
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    changed = connection.exec_driver_sql(
        "UPDATE sqlite_master SET sql = replace(sql, ?, ?) WHERE type = 'table' AND name = 'meshes'", (old, new)
    )
    if changed.rowcount != 1:
        raise RuntimeError("the schema has no table of meshes")
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")


def comment(new: str, old: str) -> None:
    if op.get_context().dialect.supports_comments:
        op.create_table_comment("meshes", new, existing_comment=old)
