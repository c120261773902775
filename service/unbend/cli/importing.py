"""`unbend import`."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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
    warn_of,
)
from unbend.errors import MeshError, ParameterError, ServiceError, UnbendError
from unbend.mesh.policy import MeshPolicy

if TYPE_CHECKING:
    from unbend.client import Job

EXIT_SOME_FAILED = 3
_AHEAD = 64  # uploads sent before the first is waited for, so that no worker is idle


@dataclass(frozen=True)
class _Ended:
    """A file that was imported, or why it was not."""

    path: Path
    error: str = ""
    warnings: Sequence[str] = ()


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
        ended = list(bar)
    for file in ended:
        if file.error:
            warn(f"{file.path}: {file.error}")
        warn_of(file.path, file.warnings)
    imported = sum(not file.error for file in ended)
    click.echo(f"{imported} of {len(files)} shapes imported")
    if imported < len(files):
        sys.exit(EXIT_SOME_FAILED)


def _into_library(url: str, files: Sequence[LabelledFile], parameters: Values, policy: Values) -> Iterator[_Ended]:
    from unbend.library import Library  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    chosen, reading = Parameters.from_dict(parameters), MeshPolicy.from_dict(policy)
    with Library(url) as library:
        for file in files:
            try:
                added = library.add(file.path, label=file.label, parameters=chosen, policy=reading)
                yield _Ended(file.path, warnings=added.warnings)
            except (MeshError, ParameterError, OSError) as error:
                yield _Ended(file.path, str(error))


def _over_http(url: str, files: Sequence[LabelledFile], parameters: Values, policy: Values) -> Iterator[_Ended]:
    with connect(url) as client:
        waiting: deque[tuple[LabelledFile, Job]] = deque()
        for file in files:
            try:
                job = client.submit(file.path, label=file.label, parameters=parameters, policy=policy)
                waiting.append((file, job))
            except (UnbendError, OSError) as error:
                if _is_hopeless(error):
                    raise
                yield _Ended(file.path, str(error))
            if len(waiting) > _AHEAD:
                yield _end_of(*waiting.popleft())
        for file, job in waiting:
            yield _end_of(file, job)


def _is_hopeless(error: Exception) -> bool:
    """Whether no other file will fare better: nobody is there, we may not write, or the options are refused."""
    return isinstance(error, ServiceError) and (
        error.status in {None, 401, 403} or error.problem.get("code") == ParameterError.code
    )


def _end_of(file: LabelledFile, job: Job) -> _Ended:
    try:
        return _Ended(file.path, warnings=job.result().get("warnings", ()))
    except UnbendError as error:
        return _Ended(file.path, str(error))
