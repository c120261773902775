"""`unbend import`."""

from __future__ import annotations

import sys
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import click

from unbend.cli.connect import connect
from unbend.cli.folder import LabelledFile, find_meshes, ignored_files, read_labels
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
from unbend.errors import AccessError, MeshError, ParameterError, ServiceError, UnbendError
from unbend.mesh.policy import MeshPolicy
from unbend.names import DEFAULT_LIBRARY, printable

if TYPE_CHECKING:
    from unbend.client import Job
    from unbend.results import AddedShape

Outcome = Literal["new", "updated", "known"]

EXIT_SOME_FAILED = 3
LABELS = "labels.csv"
_COUNTED_AS: Final[dict[Outcome, str]] = {"updated": "changed", "known": "unchanged"}
_AHEAD = 64  # uploads sent before waiting for the first, so that no worker is idle


@dataclass(frozen=True)
class _Ended:
    """An imported file, or its error."""

    path: Path
    error: str = ""
    warnings: Sequence[str] = ()
    shape_id: str = ""
    outcome: Outcome = "new"


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

    With --labels, names, metadata, parameters and policies from `unbend export` are imported too; options override
    them. A shape that is stored already takes the new values.

    Unusable files are printed on standard error, and the exit status is then 3.
    """
    if labels and label_from:
        raise click.UsageError("--labels and --label-from exclude each other")
    files = read_labels(labels, folder) if labels else find_meshes(folder, label_from_folder=label_from == "folder")
    if url:
        outcomes = _over_http(url, files, parameters, policy)
    else:
        outcomes = _into_library(library or DEFAULT_LIBRARY, files, parameters, policy)
    with progress(outcomes, "importing", len(files)) as bar:
        ended = list(bar)
    for file in ended:
        if file.error:
            warn(f"{file.path}: {file.error}")
        warn_of(file.path, file.warnings)
    _warn_of_duplicates(ended)
    if not labels:
        _warn_of_ignored(folder)
    click.echo(_summary(ended))
    if any(file.error for file in ended):
        sys.exit(EXIT_SOME_FAILED)


def _warn_of_ignored(folder: Path) -> None:
    """Print the ignored files, because --labels may have been forgotten."""
    others = ignored_files(folder)
    if folder / LABELS in others:
        warn(f"{folder / LABELS} exists, but is not read without --labels")
        others.remove(folder / LABELS)
    if others:
        warn(f"{len(others)} other files are ignored, such as {printable(others[0].name)}")


def _warn_of_duplicates(ended: Sequence[_Ended]) -> None:
    first: dict[str, Path] = {}
    for file in ended:
        if not file.error and file.shape_id in first:
            warn(f"{file.path}: has the same bytes as {first[file.shape_id]}, so both are one shape")
        elif not file.error:
            first[file.shape_id] = file.path


def _summary(ended: Sequence[_Ended]) -> str:
    counts = Counter(file.outcome for file in ended if not file.error)
    parts = [f"{counts['new']} new"]
    parts += [f"{counts[outcome]} {text}" for outcome, text in _COUNTED_AS.items() if counts[outcome]]
    return f"{sum(counts.values())} of {len(ended)} shapes imported: {', '.join(parts)}"


def _into_library(url: str, files: Sequence[LabelledFile], parameters: Values, policy: Values) -> Iterator[_Ended]:
    from unbend.library import Library  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    Parameters.from_dict(parameters), MeshPolicy.from_dict(policy)  # invalid options are invalid for all files
    with Library(url) as library:
        for file in files:
            try:
                shape = library.add(
                    file.path,
                    name=file.name,
                    label=file.label,
                    metadata=file.metadata,
                    parameters=Parameters.from_dict(file.parameters | dict(parameters)),
                    policy=MeshPolicy.from_dict(file.policy | dict(policy)),
                    if_known="update",
                )
            except (MeshError, ParameterError, OSError) as error:
                yield _Ended(file.path, str(error))
            else:
                yield _Ended(file.path, warnings=shape.warnings, shape_id=shape.id, outcome=_outcome(shape))


def _over_http(url: str, files: Sequence[LabelledFile], parameters: Values, policy: Values) -> Iterator[_Ended]:
    with connect(url) as client:
        waiting: deque[tuple[LabelledFile, Job[AddedShape]]] = deque()
        for file in files:
            try:
                job = client.submit(
                    file.path,
                    name=file.name,
                    label=file.label,
                    metadata=file.metadata,
                    parameters=file.parameters | dict(parameters),
                    policy=file.policy | dict(policy),
                    if_known="update",
                )
                waiting.append((file, job))
            except (UnbendError, OSError) as error:
                if _fails_for_all(error):
                    raise
                yield _Ended(file.path, str(error))
            if len(waiting) > _AHEAD:
                yield _end_of(*waiting.popleft())
        for file, job in waiting:
            yield _end_of(file, job)


def _outcome(shape: AddedShape) -> Outcome:
    if shape.is_new:
        return "new"
    return "updated" if shape.updated else "known"


def _fails_for_all(error: Exception) -> bool:
    """Return whether an error will repeat for every file: no service, no right to write, or refused options."""
    return isinstance(error, ServiceError | AccessError | ParameterError)


def _end_of(file: LabelledFile, job: Job[AddedShape]) -> _Ended:
    try:
        shape = job.result()
        return _Ended(file.path, warnings=shape.warnings, shape_id=shape.id, outcome=_outcome(shape))
    except UnbendError as error:
        return _Ended(file.path, str(error))
