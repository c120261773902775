"""`unbend backup` and `unbend restore`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from unbend.brief import counted
from unbend.cli.options import json_option, library_option
from unbend.cli.places import check_library
from unbend.cli.terminal import confirm
from unbend.names import printable

if TYPE_CHECKING:
    from unbend.library.backups.backup import Backup

force_option = click.option("--force", is_flag=True, help="Replace an existing file or library.")


@click.command()
@click.argument("destination", metavar="DEST", type=click.Path(path_type=Path))
@library_option
@force_option
@click.option("--verify", "verify_only", is_flag=True, help="Check the backup DEST; copy nothing.")
@json_option
def backup(destination: Path, library: str, force: bool, verify_only: bool, as_json: bool) -> None:
    """Copy a library, which may be in use, into the file DEST.

    DEST is one checked state of the library, and appears complete or not at all. It contains everything: files, hashes
    of API keys, and jobs; but not the files in an object store, which needs a backup of its own. The check reads every
    row.
    """
    from unbend.library.backups.backup import backup as make_backup  # noqa: PLC0415
    from unbend.library.backups.backup import verify  # noqa: PLC0415

    if verify_only:
        found = verify(destination)
        text = f"{counted(found.shapes, 'shape')}, {found.size} bytes, schema {found.revision}, sound"
    else:
        check_library(library)
        found = make_backup(library, destination, overwrite=force)
        text = f"{counted(found.shapes, 'shape')}, {found.size} bytes, checked"
    confirm(_as_json(found), f"{found.path}: {text}{_elsewhere(found)}", as_json=as_json)


@click.command()
@click.argument("source", metavar="SOURCE", type=click.Path(path_type=Path))
@library_option
@force_option
@json_option
def restore(source: Path, library: str, force: bool, as_json: bool) -> None:
    """Replace a library, which may be in use, by the backup SOURCE.

    SOURCE is checked first. A library that ever had API keys keeps them. Replacing an existing library needs --force,
    and deletes everything that is not in SOURCE.
    """
    from unbend.library.backups.backup import restore as replace_library  # noqa: PLC0415

    made = replace_library(source, library, overwrite=force)
    text = f"{counted(made.shapes, 'shape')}, as in {source}{_elsewhere(made)}"
    confirm(_as_json(made), f"{made.path}: {text}", as_json=as_json)


def _elsewhere(found: Backup) -> str:
    """Return what a backup does not contain."""
    return f"; {counted(found.elsewhere, 'file')} in the object store" if found.elsewhere else ""


def _as_json(found: Backup) -> dict[str, object]:
    return {**vars(found), "path": printable(str(found.path))}
