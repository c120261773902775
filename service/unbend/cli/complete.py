"""`unbend complete`."""

from __future__ import annotations

import click

from unbend.brief import counted
from unbend.cli.options import json_option, library_option, objects_option
from unbend.cli.places import open_library
from unbend.cli.terminal import confirm, prepare_kernels, warn


@click.command()
@library_option
@objects_option
@json_option
def complete(library: str, as_json: bool) -> None:
    """Compute the local signatures, by which pieces are recognised, for shapes that were stored without."""
    completed: list[str] = []
    with open_library(library) as opened:
        prepare_kernels()
        for shape in opened.complete():
            completed.append(shape.id)
            warn(shape.name)
    text = f"completed {counted(len(completed), 'shape')}" if completed else "nothing is missing"
    confirm({"completed": completed}, text, as_json=as_json)
