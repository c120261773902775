"""`unbend export`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.brief import counted
from unbend.cli.options import json_option, library_option, objects_option
from unbend.cli.places import open_library
from unbend.cli.terminal import confirm
from unbend.names import printable


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@library_option
@objects_option
@json_option
def export(folder: Path, library: str, as_json: bool) -> None:
    """Write every shape's file, and labels.csv, to DIR, which must be empty.

    `unbend import DIR --labels DIR/labels.csv` and `unbend evaluate` read such a folder.
    """
    with open_library(library) as opened:
        count = opened.export(folder)
    place = printable(str(folder))
    confirm({"folder": place, "shapes": count}, f"{place}: {counted(count, 'shape')}", as_json=as_json)
