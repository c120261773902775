"""`unbend import`."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from unbend.cli.connect import connect
from unbend.cli.folder import LabelledFile, find_meshes, read_labels
from unbend.cli.options import (
    Values,
    folder_argument,
    library_option,
    parameter_options,
    policy_options,
    progress,
    url_option,
    warn,
)
from unbend.errors import MeshError, ParameterError, ServiceError, UnbendError
from unbend.mesh.policy import MeshPolicy

if TYPE_CHECKING:
    from unbend.client import Job

EXIT_SOME_FAILED = 3
_AHEAD = 64  # uploads sent before the first is waited for, so that no worker is idle


@click.command("import")
@folder_argument
@click.option("--labels", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="CSV: path, class.")
@click.option("--label-from", type=click.Choice(["folder"]), help="Take each file's folder as its class.")
@library_option
@url_option
@parameter_options
@policy_options
def import_folder(
    folder: Path,
    labels: Path | None,
    label_from: str | None,
    library: str | None,
    url: str | None,
    parameters: Values,
    policy: Values,
) -> None:
    """Add the meshes of DIR to a library, or to a running service.

    Files that cannot be used are named on standard error; the exit status is then 3.
    """
    if labels and label_from:
        raise click.UsageError("--labels and --label-from exclude each other")
    files = read_labels(labels, folder) if labels else find_meshes(folder, label_from_folder=label_from == "folder")
    if url:
        outcomes = _over_http(url, files, parameters, policy)
    else:
        outcomes = _into_library(library or "unbend.db", files, parameters, policy)
    with progress(outcomes, "importing", len(files)) as bar:
        failures = [failure for failure in bar if failure]
    for failure in failures:
        warn(failure)
    click.echo(f"{len(files) - len(failures)} of {len(files)} shapes imported")
    if failures:
        sys.exit(EXIT_SOME_FAILED)


def _into_library(url: str, files: Sequence[LabelledFile], parameters: Values, policy: Values) -> Iterator[str]:
    from unbend.library import Library  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    chosen, reading = Parameters.from_dict(parameters), MeshPolicy.from_dict(policy)
    with Library(url) as library:
        for file in files:
            try:
                library.add(file.path, label=file.label, parameters=chosen, policy=reading)
                yield ""
            except (MeshError, OSError) as error:
                yield f"{file.path}: {error}"


def _over_http(url: str, files: Sequence[LabelledFile], parameters: Values, policy: Values) -> Iterator[str]:
    with connect(url) as client:
        waiting: deque[tuple[LabelledFile, Job]] = deque()
        for file in files:
            try:
                job = client.submit(file.path, label=file.label, parameters=parameters, policy=policy)
                waiting.append((file, job))
            except (UnbendError, OSError) as error:
                if _is_hopeless(error):
                    raise
                yield f"{file.path}: {error}"
            if len(waiting) > _AHEAD:
                yield _failure(*waiting.popleft())
        for file, job in waiting:
            yield _failure(file, job)


def _is_hopeless(error: Exception) -> bool:
    """Whether no other file will fare better: nobody is there, we may not write, or the options are refused."""
    return isinstance(error, ServiceError) and (
        error.status in {None, 401, 403} or error.problem.get("code") == ParameterError.code
    )


def _failure(file: LabelledFile, job: Job) -> str:
    try:
        job.result()
    except UnbendError as error:
        return f"{file.path}: {error}"
    return ""
