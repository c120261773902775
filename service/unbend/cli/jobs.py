"""`unbend jobs`."""

from __future__ import annotations

import click

from unbend.cli.options import json_option, place_options
from unbend.cli.places import first, open_place
from unbend.cli.tables import table
from unbend.cli.terminal import print_result

STATES = ("queued", "running", "succeeded", "failed", "cancelled")


@click.command()
@click.option("--state", type=click.Choice(STATES), help="Only the jobs in this state.")
@click.option("--limit", metavar="N", type=click.IntRange(min=1), default=20, show_default=True, help="At most N jobs.")
@click.option("--cancel", "cancelled", metavar="ID", multiple=True, help="Cancel this job; may be repeated.")
@place_options
@json_option
def jobs(
    state: str | None, limit: int, cancelled: tuple[str, ...], library: str, url: str | None, as_json: bool
) -> None:
    """List the jobs of a service, or of the library that it serves, the newest first; or cancel some.

    Use --url to cancel a job that runs: without it, a server that computes the job stops only at its end.
    """
    with open_place(library, url) as place:
        found = [place.cancel(job_id) for job_id in cancelled] if cancelled else first(place.jobs(state), limit)
    print_result({"jobs": found}, lambda: _table(found) if found else "there are no jobs", as_json=as_json)


def _table(found: list[dict[str, object]]) -> str:
    rows = [[job["id"], job["kind"], job["state"], job["created_at"], _remark(job)] for job in found]
    return table(["id", "kind", "state", "sent", "remark"], rows)


def _remark(job: dict[str, object]) -> object:
    """Return the error of a job, its place in the queue, how far it is, or its shape."""
    error = job["error"]
    if isinstance(error, dict):
        return error["message"]
    if job["state"] == "queued" and job["position"] is not None:
        return f"{job['position']} before it"
    if job["state"] == "running":
        return f"{job['stage']}, {job['progress']:.0%}"
    return job["shape_id"]
