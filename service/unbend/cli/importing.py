"""`unbend import`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from unbend.cli.folders.account import account_for, accounting, meshes_of, report_option
from unbend.cli.folders.computing import Machine, machine_options
from unbend.cli.folders.files import MeshFolder
from unbend.cli.folders.import_options import ImportOptions, check_labels, labels_option
from unbend.cli.group import EXIT_SOME_FAILED
from unbend.cli.options import (
    Values,
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
_KEPT: Final = "what is stored stays, and the same command continues with the other files"


@click.command("import")
@click.argument("folder", metavar="DIR", type=click.Path(exists=True, path_type=Path))
@labels_option
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

    If DIR is a folder of shards by `unbend compute`, or one of them, the results are stored without computing. Their
    parameters and policies are those of `unbend compute`. --labels and --label-from override its classes.

    With --labels, names, metadata, parameters and policies from `unbend export` are imported too; options override
    them. A row whose class is empty changes no class: `unbend label ID --none` removes one.

    The import uses all cores, and stores each shape once it is computed: after an interruption, the same command
    continues. Standard error says what happened to the files, and --report to each of them. The exit status is 4 if
    some failed.
    """
    check_labels(labels, label_from)
    if url and without_parts:
        raise click.UsageError("--url and --without-parts exclude each other")
    options = ImportOptions(parameters, policy, if_known, not without_parts, machine)
    if _is_shards(folder):
        _import_shards(folder, labels, label_from, report, library, url, as_json, options)
        return
    skipped = [] if url else _files_of_library(library)
    source = MeshFolder(folder, labels, label_from == "folder", [*skipped, report] if report else skipped)
    with accounting(folder, report, kept=_KEPT) as account:
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


def _is_shards(path: Path) -> bool:
    """Return whether results are imported; UsageError if `path` is a file, but no shard."""
    from unbend.cli.folders.sharding import is_shards  # noqa: PLC0415

    found = is_shards(path)
    if not found and not path.is_dir():
        raise click.UsageError(f"{path} is neither a folder nor a shard")
    return found


def _import_shards(
    folder: Path,
    labels: Path | None,
    label_from: str | None,
    report: Path | None,
    library: str,
    url: str | None,
    as_json: bool,
    options: ImportOptions,
) -> None:
    from unbend.cli.folders.import_shards import import_shards  # noqa: PLC0415
    from unbend.cli.folders.sharding import ShardFolder  # noqa: PLC0415
    from unbend.library.shards.index import ShardIndex  # noqa: PLC0415

    if url:
        raise ParameterError(
            "a service takes no results: it could not check that they belong to the meshes"
        ).with_advice(
            "Import the shards by --library on the machine of the library, or the folder of the meshes by --url."
        )
    if options.parameters or options.policy:
        raise click.UsageError("parameters and policies of shards are chosen by `unbend compute`")
    with accounting(Path(), report, kept=_KEPT) as account, ShardIndex() as index:
        source = ShardFolder(
            folder, index, labels, label_from_folder=label_from == "folder", skipped=[report] if report else []
        )
        files = meshes_of(source, account)
        account_for(import_shards(library, files, index, options), account, "importing")
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
