"""`unbend import`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from unbend.cli.folders.account import account_for, accounting, meshes_of, report_option
from unbend.cli.folders.computing import Machine, machine_options
from unbend.cli.folders.files import MeshFolder
from unbend.cli.folders.import_options import ImportOptions
from unbend.cli.group import EXIT_SOME_FAILED
from unbend.cli.options import (
    Values,
    folder_argument,
    json_option,
    label_from_option,
    parameter_options,
    place_options,
    policy_options,
)
from unbend.cli.terminal import prepare_kernels, warn
from unbend.errors import ParameterError

if TYPE_CHECKING:
    from unbend.results.shapes import IfKnown

LABELS: Final = "labels.csv"


@click.command("import")
@folder_argument
@click.option("--labels", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="CSV: path, class.")
@label_from_option
@click.option(
    "--if-known",
    type=click.Choice(["update", "keep"]),
    default="update",
    show_default=True,
    help="Whether a shape that is stored already takes the new name, class and metadata.",
)
@click.option(
    "--without-parts",
    is_flag=True,
    help="Do not compute what pieces are recognised by; `unbend complete` computes it later. Not with --url.",
)
@report_option
@place_options
@json_option
@machine_options
@parameter_options
@policy_options
def import_folder(
    folder: Path,
    labels: Path | None,
    label_from: str | None,
    if_known: IfKnown,
    without_parts: bool,
    report: Path | None,
    library: str,
    url: str | None,
    as_json: bool,
    machine: Machine,
    parameters: Values,
    policy: Values,
) -> None:
    """Add the meshes of DIR to a library, or to a running service.

    With --labels, names, metadata, parameters and policies from `unbend export` are imported too; options override
    them. A row whose class is empty changes no class: `unbend label ID --none` removes one.

    The import uses all cores, and stores each shape once it is computed: after an interruption, the same command
    continues. Standard error says what happened to the files, and --report to each of them. The exit status is 4 if
    some failed.
    """
    if labels and label_from:
        raise click.UsageError("--labels and --label-from exclude each other")
    if labels and not labels.is_file():
        raise click.UsageError("--labels must be a file on disk, because it is read twice")
    if url and without_parts:
        raise click.UsageError("--url and --without-parts exclude each other")
    skipped = [] if url else _files_of_library(library)
    source = MeshFolder(folder, labels, label_from == "folder", [*skipped, report] if report else skipped)
    options = ImportOptions(parameters, policy, if_known, not without_parts, machine)
    kept = "what is stored stays, and the same command continues with the other files"
    with accounting(folder, report, kept=kept) as account:
        files = meshes_of(source, account)
        if url:
            from unbend.cli.folders.import_over_http import import_over_http  # noqa: PLC0415

            ended = import_over_http(url, files, options)
        else:
            from unbend.cli.folders.import_into_library import import_into_library  # noqa: PLC0415

            prepare_kernels()
            ended = import_into_library(library, files, account.meshes, options)
        account_for(ended, account, "importing")
        if not labels and (folder / LABELS).is_file():
            warn(f"{folder / LABELS} exists, but is not read without --labels")
    account.print_result("shapes imported", as_json=as_json)
    if account.has_faults:
        sys.exit(EXIT_SOME_FAILED)


def _files_of_library(url: str) -> list[Path]:
    """Return the files of a library, which may be in the imported folder."""
    from unbend.library.storage.database import sqlite_file  # noqa: PLC0415

    try:
        path = sqlite_file(url)
    except ParameterError:  # another database, or an address that is refused later
        return []
    return [Path(f"{path}{suffix}") for suffix in ("", "-wal", "-shm", "-journal", "-lease", "-reserve")]
