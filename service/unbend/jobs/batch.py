"""Computation of many files on all cores, without a queue or a store, for the command line."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import TypeVar

from unbend.arrays import Floats
from unbend.embedding.embed import Method
from unbend.errors import MeshReadError, UnbendError
from unbend.jobs.limits import limit_process
from unbend.jobs.process import WorkerProcess
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh
from unbend.render.picture import render_picture
from unbend.render.request import PictureRequest
from unbend.signature.dimensions import moments_over_dimensions
from unbend.signature.from_file import signature_of_file
from unbend.signature.parameters import Parameters
from unbend.signature.signature import Signature
from unbend.threads import available_cores

T = TypeVar("T")


@dataclass(frozen=True)
class PathResult:
    """The results for one file."""

    signature: Signature
    picture: bytes | None
    """A picture of the surface; None if none was asked for."""


def compute_path(
    path: Path, parameters: Parameters, policy: MeshPolicy | None, picture: PictureRequest | None = None
) -> PathResult:
    """Return the signature of the mesh at `path`, and the requested picture of its surface."""
    found = signature_of_file(path, parameters, policy, threads=1)
    return PathResult(found.signature, render_picture(picture, found.surface, threads=1) if picture else None)


def dimensions_of_path(path: Path, parameters: Parameters, policy: MeshPolicy | None) -> dict[Method, Floats]:
    """Return `moments_over_dimensions` of the mesh at `path`."""
    return moments_over_dimensions(read_mesh(path, policy=policy), parameters, threads=1)


def compute_paths(
    paths: Sequence[Path],
    parameters: Parameters,
    policy: MeshPolicy | None = None,
    *,
    picture: PictureRequest | None = None,
) -> Iterator[PathResult | UnbendError]:
    """Yield the signature and the requested picture of each path, or its error, in the order of the paths."""
    return compute_each(partial(compute_path, picture=picture), paths, parameters, policy)


def compute_each(
    compute: Callable[[Path, Parameters, MeshPolicy | None], T],
    paths: Sequence[Path],
    parameters: Parameters,
    policy: MeshPolicy | None = None,
) -> Iterator[T | UnbendError]:
    """Yield the result of `compute` for each path, or its error, in the order of the paths.

    Each core has a process. If a process dies, only its file fails.
    """
    count = min(available_cores(), max(1, len(paths)))
    free: SimpleQueue[WorkerProcess] = SimpleQueue()
    for _ in range(count):
        free.put(WorkerProcess(partial(limit_process, None)))

    def outcome(path: Path) -> T | UnbendError:
        worker = free.get()
        try:
            return worker.run(compute, (path, parameters, policy))
        except UnbendError as error:
            return error
        except OSError as error:
            return MeshReadError(f"{path}: {error.strerror}")
        finally:
            free.put(worker)

    with ThreadPoolExecutor(count) as threads:
        try:
            yield from threads.map(outcome, paths)
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
            for _ in range(count):
                free.get().end()
