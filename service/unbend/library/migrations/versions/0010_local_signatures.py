"""Local signatures of shapes, and the length of each surface's boundary; earlier shapes have neither."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("signatures", sa.Column("boundary", sa.Float()))
    op.create_table(
        "local_signatures",
        sa.Column("signature_id", sa.Integer(), nullable=False),
        sa.Column("version", sa.String(), nullable=False),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["signature_id"], ["signatures.id"], name=op.f("fk_local_signatures_signature_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("signature_id", name=op.f("pk_local_signatures")),
        comment="Local signatures, by which pieces are recognised; shapes of earlier versions have none.",
    )


def downgrade() -> None:
    op.drop_table("local_signatures")
    op.drop_column("signatures", "boundary")
