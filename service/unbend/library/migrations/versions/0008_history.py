"""History: rankings refer to shapes, ended jobs drop their requests, shapes get a time of change, and jobs an owner."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

BATCH = 500
JOBS = sa.table(
    "jobs", sa.column("seq", sa.Integer()), sa.column("state", sa.String()), sa.column("request", sa.JSON()),
    sa.column("result", sa.JSON()),
)  # fmt: skip
SHAPES = sa.table(
    "shapes", sa.column("seq", sa.Integer()), sa.column("id", sa.String()), sa.column("label", sa.String()),
    sa.column("created_at", sa.Float()), sa.column("updated_at", sa.Float()),
)  # fmt: skip
LABELS = sa.table("labels", sa.column("id", sa.Integer()), sa.column("text", sa.String()))


def upgrade() -> None:
    op.create_table(
        "labels",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("text", sa.String(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_labels")),
        sa.UniqueConstraint("text", name=op.f("uq_labels_text")),
        comment="Classes that stored answers name; each goes with its last member.",
        sqlite_autoincrement=True,
    )
    op.create_table(
        "job_files",
        sa.Column("job_seq", sa.Integer(), nullable=False),
        sa.Column("file_type", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["job_seq"], ["jobs.seq"], name=op.f("fk_job_files_job_seq"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job_seq", name=op.f("pk_job_files")),
        comment="What jobs of the kind file made; kept for a day.",
    )
    op.create_index(op.f("ix_jobs_shape_id"), "jobs", ["shape_id"])
    op.create_index(op.f("ix_jobs_finished_at"), "jobs", ["finished_at"])
    op.add_column("jobs", sa.Column("owner", sa.String(12)))
    op.add_column("jobs", sa.Column("idempotency", sa.String(64)))
    op.add_column("jobs", sa.Column("fingerprint", sa.String(64)))
    op.add_column("jobs", sa.Column("ignored", sa.JSON(), nullable=False, server_default="[]"))
    op.add_column("jobs", sa.Column("callback", sa.String()))
    op.add_column("jobs", sa.Column("callback_attempts", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("jobs", sa.Column("callback_due", sa.Float()))
    op.create_index(op.f("ix_jobs_callback_due"), "jobs", ["callback_due"])
    op.create_index(op.f("ix_jobs_state_owner_seq"), "jobs", ["state", "owner", "seq"])
    op.create_index(op.f("ix_jobs_idempotency"), "jobs", ["idempotency"])
    op.add_column("api_keys", sa.Column("expires_at", sa.Float()))
    op.add_column("api_keys", sa.Column("most_jobs", sa.Integer()))
    op.add_column("shapes", sa.Column("updated_at", sa.Float(), nullable=False, server_default="0"))
    op.execute(SHAPES.update().values(updated_at=SHAPES.c.created_at))
    ended = JOBS.c.state.in_(("succeeded", "failed", "cancelled"))
    op.execute(JOBS.update().where(ended).values(request={}))
    convert(op.get_bind())


def convert(connection: sa.Connection) -> None:
    """Replace ids in stored rankings by seqs of shapes and rows of `labels`."""
    seqs = dict(connection.execute(sa.select(SHAPES.c.id, SHAPES.c.seq)).all())
    present = connection.scalars(sa.select(SHAPES.c.label).where(SHAPES.c.label.is_not(None)).distinct()).all()
    labels: dict[str, int] = {}
    last = 0
    while True:
        later = sa.select(JOBS.c.seq, JOBS.c.result).where(JOBS.c.seq > last)
        rows = connection.execute(later.order_by(JOBS.c.seq).limit(BATCH)).all()
        if not rows:
            return
        for seq, result in rows:
            if not result:
                continue
            named = {each["label"] for each in result["classes"]} & set(present)
            for text in sorted(named - set(labels)):
                labels[text] = connection.scalar(LABELS.insert().values(text=text).returning(LABELS.c.id))
            changed = result | {
                "shapes": [[seqs[each["id"]], each["distance"]] for each in result["shapes"] if each["id"] in seqs],
                "classes": [
                    [labels[each["label"]], each["distance"], each["confidence"]]
                    for each in result["classes"]
                    if each["label"] in named
                ],
            }
            connection.execute(JOBS.update().where(JOBS.c.seq == seq).values(result=changed))
        last = rows[-1].seq


def downgrade() -> None:
    # Rankings stay unchanged: earlier versions show them without shapes and classes.
    connection = op.get_bind()
    for seq, result in connection.execute(sa.select(JOBS.c.seq, JOBS.c.result)).all():
        if result:
            emptied = result | {"shapes": [], "classes": []}
            connection.execute(JOBS.update().where(JOBS.c.seq == seq).values(result=emptied))
    for column in ("most_jobs", "expires_at"):
        op.drop_column("api_keys", column)
    for index in ("ix_jobs_callback_due", "ix_jobs_idempotency", "ix_jobs_state_owner_seq"):
        op.drop_index(op.f(index), "jobs")
    for column in ("callback_due", "callback_attempts", "callback", "ignored", "fingerprint", "idempotency", "owner"):
        op.drop_column("jobs", column)
    op.drop_column("shapes", "updated_at")
    op.drop_index(op.f("ix_jobs_finished_at"), "jobs")
    op.drop_index(op.f("ix_jobs_shape_id"), "jobs")
    op.drop_table("job_files")
    op.drop_table("labels")
