"""Tickets of a cluster's queue, which are rows of Procrastinate: those of dead workers, and those that are missing.

Procrastinate finds the tickets of dead workers, too, but not the jobs whose tickets are gone.
"""

from __future__ import annotations

from typing import Final

from sqlalchemy import Connection, text

from unbend.library.storage.queue_schema import QUEUE, TASK

_LOST: Final = text(
    """
    SELECT jobs.ticket
    FROM jobs
    LEFT JOIN procrastinate_jobs AS ticket ON ticket.id = jobs.ticket AND ticket.status = 'doing'
    LEFT JOIN procrastinate_workers AS worker
        ON worker.id = ticket.worker_id AND worker.last_heartbeat > now() - make_interval(secs => :seconds)
    WHERE jobs.state = 'running' AND jobs.ticket IS NOT NULL AND worker.id IS NULL
    """
)
_MISSING: Final = text(
    """
    SELECT (SELECT count(*) FROM jobs WHERE state = 'queued') - (
        SELECT count(*)
        FROM procrastinate_jobs AS ticket
        LEFT JOIN procrastinate_workers AS worker
            ON worker.id = ticket.worker_id AND worker.last_heartbeat > now() - make_interval(secs => :seconds)
        WHERE ticket.status = 'todo' OR (
            ticket.status = 'doing' AND worker.id IS NOT NULL
            AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.state = 'running' AND jobs.ticket = ticket.id)
        )
    )
    """
)
_DELETE_DEAD: Final = text(
    """
    DELETE FROM procrastinate_jobs AS ticket
    WHERE ticket.status = 'doing'
    AND NOT EXISTS (
        SELECT 1 FROM procrastinate_workers AS worker
        WHERE worker.id = ticket.worker_id AND worker.last_heartbeat > now() - make_interval(secs => :seconds)
    )
    AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.state = 'running' AND jobs.ticket = ticket.id)
    """
)
_ISSUE: Final = text(
    f"""
    SELECT procrastinate_defer_jobs_v1(array_agg(
        ROW('{QUEUE}', '{TASK}', 0, NULL, NULL, '{{}}'::jsonb, NULL)::procrastinate_job_to_defer_v1
    ))
    FROM generate_series(1, :number)
    """  # noqa: S608  both names are ours
)


def lost_tickets(connection: Connection, seconds: float) -> list[int]:
    """Return the tickets of running jobs whose worker has sent no heartbeat for `seconds`, or has ended."""
    return list(connection.scalars(_LOST, {"seconds": seconds}))


def count_missing(connection: Connection, seconds: float) -> int:
    """Return by how many the queued jobs outnumber the tickets that may still claim one; negative if there are more."""
    return int(connection.scalar(_MISSING, {"seconds": seconds}) or 0)


def issue(connection: Connection, number: int) -> None:
    """Add tickets to the queue."""
    connection.execute(_ISSUE, {"number": number})


def delete_dead(connection: Connection, seconds: float) -> None:
    """Delete the tickets of dead workers that have no job."""
    connection.execute(_DELETE_DEAD, {"seconds": seconds})
