"""`unbend remove`."""

from __future__ import annotations

import sys

import click

from unbend.cli.advice import advice_for
from unbend.cli.group import EXIT_SOME_FAILED
from unbend.cli.options import json_option, place_options
from unbend.cli.places import open_place
from unbend.cli.terminal import confirm, print_error
from unbend.errors import NotFoundError


@click.command()
@click.argument("shape_ids", metavar="ID...", nargs=-1, required=True)
@place_options
@json_option
@click.pass_context
def remove(context: click.Context, /, shape_ids: tuple[str, ...], library: str, url: str | None, as_json: bool) -> None:
    """Remove shapes with their signatures and files, for good.

    An ID that does not exist is printed on standard error, and the exit status is then 4.
    """
    removed: list[str] = []
    advice = ""
    with open_place(library, url) as place:
        for shape_id in shape_ids:
            try:
                place.remove(shape_id)
                removed.append(shape_id)
            except NotFoundError as error:
                print_error(f"unbend: {error}")
                advice = advice_for(error, context.command, context)
    if advice:
        print_error(f"        {advice}")
    confirm({"removed": removed}, f"{len(removed)} of {len(shape_ids)} shapes removed", as_json=as_json)
    if len(removed) < len(shape_ids):
        sys.exit(EXIT_SOME_FAILED)
