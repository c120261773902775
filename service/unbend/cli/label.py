"""`unbend label`."""

from __future__ import annotations

import click

from unbend.cli.options import json_option, place_options
from unbend.cli.places import open_place, whole_id
from unbend.cli.terminal import confirm


@click.command()
@click.argument("shape_id", metavar="ID")
@click.argument("label", metavar="[CLASS]", required=False)
@click.option("--none", "remove", is_flag=True, help="Remove the class of the shape.")
@place_options
@json_option
def label(shape_id: str, label: str | None, remove: bool, library: str, url: str | None, as_json: bool) -> None:
    """Set the class of the shape ID to CLASS, or remove it with --none.

    The first digits of an ID suffice, 6 or more, if no other shape has the same.
    """
    if (label is None) != remove:
        raise click.UsageError("give either a CLASS or --none")
    with open_place(library, url) as place:
        shape = place.change(whole_id(place, shape_id), label=label)
    text = "has no class" if remove else f"has the class {shape.label}"
    confirm(shape.as_dict(), f"{shape.id} ({shape.name}) {text}", as_json=as_json)
