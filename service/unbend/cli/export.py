"""`unbend export`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.options import library_option
from unbend.names import DEFAULT_LIBRARY, printable


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@library_option
def export(folder: Path, library: str | None) -> None:
    """Write every shape's file, and labels.csv, to DIR, which must be empty.

    `unbend import DIR --labels DIR/labels.csv` and `unbend evaluate` read such a folder.
    """
    from unbend.library import Library  # noqa: PLC0415
    from unbend.library.storage.database import must_exist  # noqa: PLC0415

    url = library or DEFAULT_LIBRARY
    must_exist(url)
    with Library(url) as opened:
        count = opened.export(folder)
    click.echo(f"{printable(str(folder))}: {count} shapes")
