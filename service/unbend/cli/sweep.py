"""`unbend sweep`."""

from __future__ import annotations

import sys
from datetime import timedelta
from typing import TYPE_CHECKING, Any, Literal

import click

from unbend.brief import counted
from unbend.cli.group import EXIT_SOME_FAILED
from unbend.cli.options import json_option, library_option, objects_option
from unbend.cli.places import open_library
from unbend.cli.terminal import confirm, progress, warn
from unbend.names import printable

if TYPE_CHECKING:
    from unbend.library import Library
    from unbend.library.sweeping import Sweep

_SHOWN = 20


@click.command()
@library_option
@objects_option
@click.option("--delete", is_flag=True, help="Delete the objects that no mesh needs.")
@click.option(
    "--grace",
    metavar="HOURS",
    type=click.FloatRange(min=0),
    default=24.0,
    show_default=True,
    help="Age at which an object without a mesh counts as unneeded.",
)
@click.option("--to-objects", "home", flag_value="objects", help="Move all meshes into the object store instead.")
@click.option("--to-database", "home", flag_value="database", help="Move all meshes into the database instead.")
@json_option
def sweep(library: str, delete: bool, grace: float, home: Literal["objects", "database"] | None, as_json: bool) -> None:
    """Find objects without a mesh, and meshes without an object.

    The library and its object store may be in use. Without --delete, nothing is deleted but what was removed from the
    library before. Use --delete only if no other library has the same prefix. The exit status is 4 if the objects of
    some meshes are missing.

    With --to-objects or --to-database, meshes move; an interrupted move continues with the same command.
    """
    if home and delete:
        raise click.UsageError("--delete excludes --to-objects and --to-database")
    with open_library(library) as opened:
        if home:
            _move(opened, home, as_json=as_json)
            return
        found = _sweep(opened, delete, grace, as_json=as_json)
    if found.missing:
        sys.exit(EXIT_SOME_FAILED)


def _sweep(library: Library, delete: bool, grace: float, *, as_json: bool) -> Sweep:
    from unbend.library.sweeping import count_waiting  # noqa: PLC0415
    from unbend.library.sweeping import sweep as compare  # noqa: PLC0415

    found = compare(library, delete=delete, grace=timedelta(hours=grace))
    writes, deletions = count_waiting(library)
    for sha256 in found.missing[:_SHOWN]:
        warn(f"mesh {sha256} has no object")
    if len(found.missing) > _SHOWN:
        warn(f"and {len(found.missing) - _SHOWN} more")
    unneeded = f"{counted(len(found.orphans), 'object')} without a mesh ({found.orphan_size} bytes)"
    text = "; ".join(
        [
            f"{counted(found.objects, 'object')}, {found.size} bytes",
            f"{unneeded}{f', {found.deleted} deleted' if delete else ''}",
            f"{counted(len(found.missing), 'mesh', 'meshes')} without an object",
            f"{counted(writes, 'write')} under way, {counted(deletions, 'deletion')} waiting",
        ]
    )
    facts: dict[str, Any] = {**vars(found), "writes": writes, "deletions": deletions}
    confirm(facts, text, as_json=as_json)
    return found


def _move(library: Library, home: Literal["objects", "database"], *, as_json: bool) -> None:
    from unbend.library.sweeping import count_elsewhere, move  # noqa: PLC0415

    count = size = 0
    with progress(move(library, home), "moving meshes", count_elsewhere(library, home)) as bar:
        for _, moved in bar:
            count, size = count + 1, size + moved
    target = "object store" if home == "objects" else "database"
    where = {"moved": count, "size": size, "to": home, "library": printable(library.url)}
    confirm(where, f"{counted(count, 'mesh', 'meshes')}, {size} bytes, moved into the {target}", as_json=as_json)
