"""The effective dimension of each shape: the first value of its descriptor; none for signatures without it."""

import struct

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

SIGNATURES = sa.table("signatures", sa.column("id", sa.Integer()), sa.column("dimension", sa.Integer()))
DESCRIPTORS = sa.table(
    "descriptors", sa.column("signature_id", sa.Integer()), sa.column("measure", sa.String()),
    sa.column("vector", sa.LargeBinary()),
)  # fmt: skip


def upgrade() -> None:
    op.add_column("signatures", sa.Column("dimension", sa.Integer()))
    connection = op.get_bind()
    known = sa.select(DESCRIPTORS.c.signature_id, DESCRIPTORS.c.vector).where(DESCRIPTORS.c.measure == "dimension")
    for signature_id, vector in connection.execute(known).all():
        dimension = int(struct.unpack_from("<d", vector)[0])
        connection.execute(SIGNATURES.update().where(SIGNATURES.c.id == signature_id).values(dimension=dimension))


def downgrade() -> None:
    op.drop_column("signatures", "dimension")
