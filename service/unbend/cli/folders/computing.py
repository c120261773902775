"""Signatures of many files, computed on all cores."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from unbend.cli.folders.files import LabelledFile
from unbend.cli.options import Values
from unbend.cli.terminal import prepare_kernels, print_error, progress, warn_of
from unbend.errors import UnbendError
from unbend.mesh.policy import MeshPolicy

if TYPE_CHECKING:
    from unbend.arrays import Floats
    from unbend.embedding.embed import Method
    from unbend.render.request import PictureRequest
    from unbend.signature.signature import Signature

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


@dataclass(frozen=True)
class Machine:
    """The part of this machine that a command uses; None for the default of `Batch`."""

    workers: int | None
    memory_mb: int | None


def machine_options(command: F) -> F:
    """Add --workers and --memory-mb. The command receives them as one `Machine`, `machine`."""

    @wraps(command)
    def with_machine(*arguments: Any, workers: int | None, memory_mb: int | None, **others: Any) -> Any:
        return command(*arguments, machine=Machine(workers, memory_mb), **others)

    memory = click.option(
        "--memory-mb",
        metavar="N",
        envvar="UNBEND_JOB_MEMORY_MB",
        show_envvar=True,
        type=click.IntRange(min=1024),
        help="Most megabytes of address space of each process; by default as for `unbend serve`.",
    )
    workers = click.option(
        "--workers", metavar="N", type=click.IntRange(min=1), help="Number of processes; by default one for each core."
    )
    return cast("F", workers(memory(with_machine)))


@dataclass(frozen=True)
class Computed:
    """A file, its class, and its signature or its error; also its picture, if one was asked for."""

    file: LabelledFile
    signature: Signature | None
    error: str = ""
    picture: bytes | None = None


def compute_files(
    files: Sequence[LabelledFile],
    parameters: Values,
    policy: Values,
    machine: Machine,
    picture: PictureRequest | None = None,
) -> list[Computed]:
    """Return the signatures and the requested pictures of `files` in their order.

    Errors are printed, and other files are still computed.
    """
    prepare_kernels()
    computed = _computed(files, parameters, policy, machine, picture)
    with progress(computed, "computing signatures", len(files)) as bar:
        found = dict(bar)
    results = [found[place] for place in range(len(files))]
    for result in results:
        if result.signature is None:
            print_error(f"{result.file.path}: {result.error}")
        else:
            warn_of(result.file.path, result.signature.warnings)
    return results


def _computed(
    files: Sequence[LabelledFile], parameters: Values, policy: Values, machine: Machine, picture: PictureRequest | None
) -> Iterator[tuple[int, Computed]]:
    from unbend.jobs.batch import compute_path  # noqa: PLC0415

    for place, outcome in _each(partial(compute_path, picture=picture), files, parameters, policy, machine):
        file = files[place]
        if isinstance(outcome, UnbendError):
            yield place, Computed(file, None, str(outcome))
        else:
            yield place, Computed(file, outcome.signature, picture=outcome.picture)


def dimensions_of(
    files: Sequence[LabelledFile], parameters: Values, policy: Values, machine: Machine
) -> dict[Path, dict[Method, Floats]]:
    """Return the moments in 1 to 6 dimensions by path, without files that have errors."""
    from unbend.jobs.batch import dimensions_of_path  # noqa: PLC0415

    outcomes = _each(dimensions_of_path, files, parameters, policy, machine)
    with progress(outcomes, "embedding in 1 to 6 dimensions", len(files)) as bar:
        found = dict(bar)
    ordered = ((file.path, found[place]) for place, file in enumerate(files))
    return {path: outcome for path, outcome in ordered if not isinstance(outcome, UnbendError)}


def _each(
    compute: Callable[..., T], files: Sequence[LabelledFile], parameters: Values, policy: Values, machine: Machine
) -> Iterator[tuple[int, T | UnbendError]]:
    from unbend.jobs.batch import compute_each  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    paths = [file.path for file in files]
    given = Parameters.from_dict(parameters), MeshPolicy.from_dict(policy)
    return compute_each(compute, paths, *given, workers=machine.workers, memory_mb=machine.memory_mb)
