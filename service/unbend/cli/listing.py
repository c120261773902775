"""`unbend list`."""

from __future__ import annotations

from itertools import islice

import click

from unbend.cli.options import json_option, place_options
from unbend.cli.places import open_place
from unbend.cli.tables import table
from unbend.cli.terminal import print_result


@click.command("list")
@click.option("--label", metavar="CLASS", help="Only the shapes of this class.")
@click.option("--limit", metavar="N", type=click.IntRange(min=1), help="At most N shapes; all by default.")
@place_options
@json_option
def list_shapes(label: str | None, limit: int | None, library: str, url: str | None, as_json: bool) -> None:
    """List the shapes of a library, or of a running service, in the order of adding.

    The table has a column of --samples if the listed shapes differ in them.
    """
    with open_place(library, url) as place:
        found = list(islice(place.iter_shapes(label=label), limit))
    samples = [shape.parameters.samples for shape in found]
    differ = len(set(samples)) > 1  # a query compares only shapes of equal parameters
    rows = [
        [shape.id, shape.name, shape.label, *([count] if differ else [])]
        for shape, count in zip(found, samples, strict=True)
    ]
    print_result(
        {"shapes": [shape.as_dict() for shape in found]},
        lambda: (
            table(["id", "name", "class", *(["samples"] if differ else [])], rows) if rows else "there are no shapes"
        ),
        as_json=as_json,
    )
