"""`unbend compute`."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from unbend.cli.folders.account import account_for, accounting, meshes_of, report_option
from unbend.cli.folders.computing import Machine, machine_options
from unbend.cli.folders.files import MeshFolder
from unbend.cli.folders.import_options import ImportOptions, check_labels, labels_option
from unbend.cli.group import EXIT_SOME_FAILED
from unbend.cli.options import (
    Values,
    folder_argument,
    json_option,
    label_from_option,
    parameter_options,
    policy_options,
)
from unbend.cli.terminal import prepare_kernels


@click.command()
@folder_argument
@click.option(
    "--out",
    "output",
    metavar="DIR",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for the shards, the same for all I.",
)
@click.option(
    "--shard", "number", metavar="I/N", default="1/1", show_default=True, help="Compute the I-th of N shares."
)
@labels_option
@label_from_option
@click.option("--without-parts", is_flag=True, help="Do not compute what pieces are recognised by.")
@report_option
@json_option
@machine_options
@parameter_options
@policy_options
def compute(
    folder: Path,
    output: Path,
    number: str,
    labels: Path | None,
    label_from: str | None,
    without_parts: bool,
    report: Path | None,
    as_json: bool,
    machine: Machine,
    parameters: Values,
    policy: Values,
) -> None:
    """Compute the signatures of the meshes of DIR without a library, such as in the jobs of a cluster.

    The results are files, shards, which contain the meshes, too. `unbend import SHARDS` stores them in a library
    without computing. The share of a file depends only on its path within DIR, so further files change the share of no
    other.

    After an interruption, also by SIGTERM, the same command continues with the files that have no results. Standard
    error says what happened to the files, and --report to each of them. The exit status is 4 if some failed.
    """
    from unbend.cli.folders.compute_shards import compute_shard  # noqa: PLC0415
    from unbend.cli.folders.sharding import ShardOfFolder  # noqa: PLC0415
    from unbend.library.shards.numbering import ShardNumber  # noqa: PLC0415

    check_labels(labels, label_from)
    shard = ShardNumber.parse(number)
    skipped = [output, report] if report else [output]
    source = ShardOfFolder(MeshFolder(folder, labels, label_from == "folder", skipped), shard)
    options = ImportOptions(parameters, policy, "keep", not without_parts, machine)
    kept = "what is written stays, and the same command continues with the other files"
    with accounting(folder, report, kept=kept) as account, _termination_as_interrupt():
        files = meshes_of(source, account)
        prepare_kernels()
        ended = compute_shard(folder, output, shard, files, account.meshes, options)
        account_for(ended, account, f"computing shard {shard}")
    account.print_result("shapes computed", as_json=as_json)
    if account.has_faults:
        sys.exit(EXIT_SOME_FAILED)


@contextmanager
def _termination_as_interrupt() -> Iterator[None]:
    """Treat SIGTERM as SIGINT. Schedulers send it some seconds before SIGKILL, and the shard is finished meanwhile."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
