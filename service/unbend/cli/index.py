"""`unbend index`."""

from __future__ import annotations

import click

from unbend.cli.options import json_option, library_option
from unbend.cli.terminal import print_result


@click.command()
@library_option
@json_option
def index(library: str, as_json: bool) -> None:
    """Prepare the search by PostgreSQL, and measure its recall.

    Makes the extension pgvector, the vectors of all shapes and their index, if they are missing. Then compares the
    index with a comparison of every shape, for stored shapes as queries. Servers do all but the last by themselves, but
    their role may not be allowed to make the extension.
    """
    from unbend.library import Library  # noqa: PLC0415
    from unbend.library.storage.database import must_exist  # noqa: PLC0415

    must_exist(library)
    with Library(library) as opened:
        opened.search.prepare_vectors()
        recall = opened.search.measure_recall()
    print_result(
        {"recall": recall}, lambda: f"The search finds {recall:.1%} of the ten nearest shapes.", as_json=as_json
    )
