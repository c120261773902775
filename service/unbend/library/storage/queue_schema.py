"""The tables of a cluster's queue: Procrastinate's, and the triggers that connect them with our `jobs`.

Procrastinate keeps no record of its version in the database. So this module records which of its migrations a database
has. A database that an older release of Procrastinate made gets the migrations that it lacks.
"""

from __future__ import annotations

from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any, Final

from sqlalchemy import Column, Connection, MetaData, String, Table, insert, inspect, select

from unbend.extras import extra

QUEUE: Final = "unbend"
"""The queue of Procrastinate in which each queued job has a ticket."""

TASK: Final = "unbend.run"
"""The task of Procrastinate that a ticket asks for: to run the next job."""

CHANNEL: Final = "unbend_jobs"
"""The channel on which PostgreSQL announces that a job was added or changed its state, and workers their progress."""

_TRIGGERS: Final = "unbend 1"
"""The name of the triggers' version: a new one replaces them in existing databases."""

_CREATE_TRIGGERS: Final = f"""
CREATE OR REPLACE FUNCTION unbend_job_changed() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF NEW.state = 'queued' THEN
        PERFORM procrastinate_defer_jobs_v1(
            ARRAY[ROW('{QUEUE}', '{TASK}', 0, NULL, NULL, '{{}}'::jsonb, NULL)]::procrastinate_job_to_defer_v1[]
        );
    END IF;
    PERFORM pg_notify('{CHANNEL}', json_build_object('job', NEW.id, 'state', NEW.state)::text);
    RETURN NULL;
END $$;
CREATE OR REPLACE TRIGGER unbend_job_changed AFTER INSERT OR UPDATE OF state ON jobs
    FOR EACH ROW EXECUTE FUNCTION unbend_job_changed();
"""

_applied = Table("queue_migrations", MetaData(), Column("name", String, primary_key=True))


def upgrade(connection: Connection) -> None:
    """Create or upgrade the tables and triggers of the queue, within a migration of the database."""
    missing = missing_steps(connection)
    _applied.create(connection, checkfirst=True)
    scripts = _scripts()
    steps = [name for name in missing if name != _TRIGGERS]
    if steps and connection.scalar(select(_applied.c.name).limit(1)) is None:
        _run(connection, (scripts / "schema.sql").read_text())  # what all migrations together would make
    else:
        for name in steps:
            _run(connection, (scripts / "migrations" / name).read_text())
    if _TRIGGERS in missing:
        _run(connection, _CREATE_TRIGGERS)
    if missing:
        connection.execute(insert(_applied), [{"name": name} for name in missing])


def missing_steps(connection: Connection) -> list[str]:
    """Return the names of the migrations of the queue that a database lacks, in order; this changes nothing."""
    names = sorted(each.name for each in (_scripts() / "migrations").iterdir() if each.name.endswith(".sql"))
    is_new = not inspect(connection).has_table(_applied.name)
    present = set() if is_new else set(connection.scalars(select(_applied.c.name)))
    return [name for name in [*names, _TRIGGERS] if name not in present]


def _scripts() -> Traversable:
    with extra("cluster"):
        import procrastinate  # noqa: F401, PLC0415
    return files("procrastinate.sql")


def _run(connection: Connection, script: str) -> None:
    driver: Any = connection.connection.driver_connection
    driver.execute(script)  # not by SQLAlchemy, which allows one statement at a time
