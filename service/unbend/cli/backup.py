"""`unbend backup` and `unbend restore`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.options import library_option
from unbend.names import DEFAULT_LIBRARY

force_option = click.option("--force", is_flag=True, help="Replace an existing file or library.")


@click.command()
@click.argument("destination", metavar="DEST", type=click.Path(path_type=Path))
@library_option
@force_option
@click.option("--verify", "verify_only", is_flag=True, help="Check the backup DEST; copy nothing.")
def backup(destination: Path, library: str | None, force: bool, verify_only: bool) -> None:
    """Copy a library, which may be in use, into the file DEST.

    DEST is one checked state of the library, and appears complete or not at all. It contains everything: files, hashes
    of API keys, and jobs. The check reads every row.
    """
    from unbend.library.backups.backup import backup as make_backup  # noqa: PLC0415
    from unbend.library.backups.backup import verify  # noqa: PLC0415

    if verify_only:
        found = verify(destination)
        click.echo(f"{destination}: {found.shapes} shapes, {found.size} bytes, schema {found.revision}, sound")
        return
    made = make_backup(library or DEFAULT_LIBRARY, destination, overwrite=force)
    click.echo(f"{made.path}: {made.shapes} shapes, {made.size} bytes, checked")


@click.command()
@click.argument("source", metavar="SOURCE", type=click.Path(path_type=Path))
@library_option
@force_option
def restore(source: Path, library: str | None, force: bool) -> None:
    """Replace a library, which may be in use, by the backup SOURCE.

    SOURCE is checked first. A library that ever had API keys keeps them. Replacing an existing library needs --force,
    and deletes everything that is not in SOURCE.
    """
    from unbend.library.backups.backup import restore as replace_library  # noqa: PLC0415

    made = replace_library(source, library or DEFAULT_LIBRARY, overwrite=force)
    click.echo(f"{made.path}: {made.shapes} shapes, as in {source}")
