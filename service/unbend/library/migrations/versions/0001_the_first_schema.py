"""The first schema."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    library_state = op.create_table(
        "library_state",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_library_state")),
        comment="One row; revision counts changes to shapes other than additions, so that caches know.",
    )
    op.bulk_insert(library_state, [{"id": 1, "revision": 0}])
    op.create_table(
        "meshes",
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("size", sa.Integer(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("sha256", name=op.f("pk_meshes")),
        comment="Uploaded files, byte for byte; one row however often a file is sent.",
    )
    op.create_table(
        "jobs",
        sa.Column("seq", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("stage", sa.String(), nullable=False),
        sa.Column("progress", sa.Float(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("restarts", sa.Integer(), nullable=False),
        sa.Column("mesh_sha256", sa.String(length=64), nullable=True),
        sa.Column("file_type", sa.String(), nullable=False),
        sa.Column("parameters", sa.String(), nullable=False),
        sa.Column("request", sa.JSON(), nullable=False),
        sa.Column("error", sa.JSON(), nullable=True),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("shape_id", sa.String(length=32), nullable=True),
        sa.Column("created_at", sa.Float(), nullable=False),
        sa.Column("started_at", sa.Float(), nullable=True),
        sa.Column("finished_at", sa.Float(), nullable=True),
        sa.ForeignKeyConstraint(["mesh_sha256"], ["meshes.sha256"], name=op.f("fk_jobs_mesh_sha256")),
        sa.PrimaryKeyConstraint("seq", name=op.f("pk_jobs")),
        sa.UniqueConstraint("id", name=op.f("uq_jobs_id")),
        comment="The queue and its history.",
        sqlite_autoincrement=True,
    )
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_jobs_mesh_sha256"), ["mesh_sha256"], unique=False)
        batch_op.create_index(batch_op.f("ix_jobs_state_seq"), ["state", "seq"], unique=False)

    op.create_table(
        "signatures",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("mesh_sha256", sa.String(length=64), nullable=False),
        sa.Column("parameters", sa.String(), nullable=False),
        sa.Column("version", sa.String(), nullable=False),
        sa.Column("report", sa.JSON(), nullable=False),
        sa.Column("area", sa.Float(), nullable=False),
        sa.Column("stress", sa.Float(), nullable=False),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["mesh_sha256"], ["meshes.sha256"], name=op.f("fk_signatures_mesh_sha256")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_signatures")),
        sa.UniqueConstraint(
            "mesh_sha256", "parameters", "version", name=op.f("uq_signatures_mesh_sha256_parameters_version")
        ),
        comment="What was computed: one row for a file, parameters and version of the algorithm.",
    )
    op.create_table(
        "descriptors",
        sa.Column("signature_id", sa.Integer(), nullable=False),
        sa.Column("measure", sa.String(), nullable=False),
        sa.Column("vector", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["signature_id"], ["signatures.id"], name=op.f("fk_descriptors_signature_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("signature_id", "measure", name=op.f("pk_descriptors")),
        comment="Vectors for comparing, little-endian float64.",
    )
    op.create_table(
        "shapes",
        sa.Column("seq", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("label", sa.String(), nullable=True),
        sa.Column("metadata", sa.JSON(), nullable=False),
        sa.Column("signature_id", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.Float(), nullable=False),
        sa.ForeignKeyConstraint(["signature_id"], ["signatures.id"], name=op.f("fk_shapes_signature_id")),
        sa.PrimaryKeyConstraint("seq", name=op.f("pk_shapes")),
        sa.UniqueConstraint("id", name=op.f("uq_shapes_id")),
        sa.UniqueConstraint("signature_id", name=op.f("uq_shapes_signature_id")),
        comment="The library's members. seq never comes again, so that pages and the search index can rely on it.",
        sqlite_autoincrement=True,
    )
    with op.batch_alter_table("shapes", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_shapes_label_seq"), ["label", "seq"], unique=False)


def downgrade() -> None:
    with op.batch_alter_table("shapes", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_shapes_label_seq"))

    op.drop_table("shapes")
    op.drop_table("descriptors")
    op.drop_table("signatures")
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_jobs_state_seq"))
        batch_op.drop_index(batch_op.f("ix_jobs_mesh_sha256"))

    op.drop_table("jobs")
    op.drop_table("meshes")
    op.drop_table("library_state")
