"""`unbend complete`."""

from __future__ import annotations

import click

from unbend.cli.options import library_option
from unbend.names import DEFAULT_LIBRARY


@click.command()
@library_option
def complete(library: str | None) -> None:
    """Compute the local signatures, by which pieces are recognised, for shapes that earlier versions stored."""
    from unbend.library import Library  # noqa: PLC0415

    with Library(library or DEFAULT_LIBRARY) as opened:
        count = 0
        for shape in opened.complete():
            count += 1
            click.echo(shape.name)
    click.echo(f"completed {count} shapes" if count else "nothing is missing")
