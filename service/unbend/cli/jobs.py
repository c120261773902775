"""`unbend jobs`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from unbend.cli.options import json_option, place_options
from unbend.cli.places import cancel_job, open_place
from unbend.cli.tables import table, timestamp
from unbend.cli.terminal import print_result

if TYPE_CHECKING:
    from unbend.results.jobs import JobState, JobStatus

STATES = ("queued", "running", "succeeded", "failed", "cancelled")


@click.command()
@click.option("--state", type=click.Choice(STATES), help="Only the jobs in this state.")
@click.option(
    "--limit", metavar="N", type=click.IntRange(1, 500), default=20, show_default=True, help="At most N jobs."
)
@click.option("--cancel", "cancelled", metavar="ID", multiple=True, help="Cancel this job; may be repeated.")
@place_options
@json_option
def jobs(
    state: JobState | None, limit: int, cancelled: tuple[str, ...], library: str, url: str | None, as_json: bool
) -> None:
    """List the jobs of a service, or of the library that it serves, the newest first; or cancel some.

    Use --url to cancel a job that runs: without it, a server that computes the job stops only at its end.
    """
    with open_place(library, url) as place:
        found = [cancel_job(place, job_id) for job_id in cancelled] or place.list_jobs(state=state, limit=limit)
    document = {"jobs": [job.as_dict() for job in found]}
    print_result(document, lambda: _table(found) if found else "there are no jobs", as_json=as_json)


def _table(found: list[JobStatus]) -> str:
    rows = [[job.id, job.kind, job.state, timestamp(job.created_at), _remark(job)] for job in found]
    return table(["id", "kind", "state", "sent (UTC)", "remark"], rows)


def _remark(job: JobStatus) -> str | None:
    """Return the error of a job, its place in the queue, how far it is, or its shape."""
    if job.error:
        return job.error.message
    if job.position is not None:
        return f"{job.position} before it"
    return f"{job.stage}, {job.progress:.0%}" if job.state == "running" else job.shape_id
