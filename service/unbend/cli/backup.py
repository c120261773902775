"""`unbend backup` and `unbend restore`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.options import library_option

force_option = click.option("--force", is_flag=True, help="Replace what is there.")


@click.command()
@click.argument("destination", metavar="DEST", type=click.Path(path_type=Path))
@library_option
@force_option
@click.option("--verify", "only", is_flag=True, help="Check the backup DEST; copy nothing.")
def backup(destination: Path, library: str | None, force: bool, only: bool) -> None:
    """Copy a library, which may be in use, into the file DEST.

    The copy is one state of the library, checked, and there whole or not at all. It has everything: files, API keys (as
    hashes), and jobs. The check reads every file, signature and document.
    """
    from unbend.library.backup import backup as make  # noqa: PLC0415
    from unbend.library.backup import verify  # noqa: PLC0415

    if only:
        found = verify(destination)
        click.echo(f"{destination}: {found.shapes} shapes, {found.size} bytes, schema {found.revision}, sound")
        return
    made = make(library or "unbend.db", destination, overwrite=force)
    click.echo(f"{made.path}: {made.shapes} shapes, {made.size} bytes, checked")


@click.command()
@click.argument("source", metavar="SOURCE", type=click.Path(path_type=Path))
@library_option
@force_option
def restore(source: Path, library: str | None, force: bool) -> None:
    """Put the backup SOURCE in the place of a library, which may be in use.

    SOURCE is checked first. The library's own API keys stay, if it ever had any. Where a library is there already,
    everything else in it is lost, and --force is needed.
    """
    from unbend.library.backup import restore as put  # noqa: PLC0415

    made = put(source, library or "unbend.db", overwrite=force)
    click.echo(f"{made.path}: {made.shapes} shapes, as in {source}")
