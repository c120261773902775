"""Computation of many files on all cores, without a queue or a store, for the command line."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import LifoQueue
from types import TracebackType
from typing import Final, Generic, Self, TypeVar

from unbend.arrays import Floats
from unbend.embedding.embed import Method
from unbend.errors import MeshReadError, UnbendError
from unbend.jobs.failures import typed_error
from unbend.jobs.limits import JobLimits, limit_process
from unbend.jobs.process import WorkerProcess
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh
from unbend.render.picture import render_picture
from unbend.render.request import PictureRequest
from unbend.signature.canonical_form import canonical_form
from unbend.signature.dimensions import moments_over_dimensions
from unbend.signature.export import export_form, export_signature
from unbend.signature.from_file import signature_of_file
from unbend.signature.parameters import Parameters
from unbend.signature.signature import Signature
from unbend.threads import available_cores

Item = TypeVar("Item")
T = TypeVar("T")

_QUEUED: Final = 2
"""Items that are started for each process and not ended: one that runs, and one so that the process never waits."""
_KEPT: Final = 8
"""Most items that are started for each process and not yielded, so that memory does not grow with their number."""
_PATIENCE_SECONDS: Final = 5.0


class Batch:
    """Processes that compute many items. A process that dies costs only its own item.

    A process starts when it is first needed. The end of the context kills all processes, also those that compute.

    Parameters
    ----------
    workers : int, optional
        Number of cores to use; by default, all.
    memory_mb : int, optional
        Address space of each process, in megabytes; by default as for the jobs of a service.
    items : int, optional
        Number of items, if known. There are no more processes than items.

    Attributes
    ----------
    threads : int
        Number of threads that the computation of an item may use: more than one if there are fewer items than cores.
    """

    def __init__(self, workers: int | None = None, memory_mb: int | None = None, items: int | None = None) -> None:
        cores = workers or available_cores()
        self.size = cores if items is None else max(1, min(cores, items))
        self.threads = cores // self.size
        memory = (memory_mb or JobLimits().memory_mb or 0) * 2**20
        self._workers = [WorkerProcess(partial(limit_process, memory)) for _ in range(self.size)]
        self._threads = ThreadPoolExecutor(self.size, thread_name_prefix="unbend batch")
        self._free: LifoQueue[WorkerProcess] = LifoQueue()
        for worker in self._workers:
            self._free.put(worker)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in self._workers:
            worker.end()
        self._threads.shutdown()

    def submit(self, compute: Callable[..., T], *arguments: object) -> Future[T]:
        """Run `compute` in the next free process. The future has its result, or an UnbendError."""
        return self._threads.submit(self._run, compute, arguments)

    def _run(self, compute: Callable[..., T], arguments: tuple[object, ...]) -> T:
        worker = self._free.get()
        try:
            return worker.run(compute, arguments)
        except OSError as error:
            if error.filename is None:  # not about a file, such as a full disk
                raise typed_error(error) from error
            raise MeshReadError(f"the file cannot be read: {error.strerror}") from error
        except Exception as error:
            raise typed_error(error) from error
        finally:
            self._free.put(worker)

    def settled(self, started: Iterable[tuple[Item, Future[T]]]) -> Iterator[list[tuple[Item, Future[T]]]]:
        """Yield the items of `started` in lists once their futures are done; take few of them from `started` at a time.

        The items keep their order where that delays nothing. A done item waits for an earlier one at most 5 seconds,
        and not at all once so many items wait that a process could become idle.
        """
        source, waiting = iter(started), _Waiting[Item, T]()
        is_exhausted = False
        while waiting.items or not is_exhausted:
            while not is_exhausted and len(waiting.items) < _KEPT * self.size and waiting.running < _QUEUED * self.size:
                if (item := next(source, None)) is None:
                    is_exhausted = True
                else:
                    waiting.items.append(item)
            if ready := waiting.take(is_full=len(waiting.items) >= _KEPT * self.size):
                yield ready


class _Waiting(Generic[Item, T]):
    """Items that are started and not yet yielded, in order."""

    def __init__(self) -> None:
        self.items: list[tuple[Item, Future[T]]] = []
        self._held_since: float | None = None
        """Time since which a done item waits for an earlier one."""

    @property
    def running(self) -> int:
        return sum(not future.done() for _, future in self.items)

    def take(self, *, is_full: bool) -> list[tuple[Item, Future[T]]]:
        """Remove and return done items; if there are none, or an earlier one runs, wait for one more, and return []."""
        done = [future.done() for _, future in self.items]
        first = done.index(False) if False in done else len(done)
        if first:
            taken, self.items = self.items[:first], self.items[first:]
            if not any(done[first:]):
                self._held_since = None
            return taken
        now = time.monotonic()
        patience = None
        if any(done):
            self._held_since = self._held_since or now
            patience = self._held_since + _PATIENCE_SECONDS - now
            if is_full or patience <= 0:
                taken = [item for item, is_done in zip(self.items, done, strict=True) if is_done]
                self.items = [item for item, is_done in zip(self.items, done, strict=True) if not is_done]
                self._held_since = None
                return taken
        running = {future for (_, future), is_done in zip(self.items, done, strict=True) if not is_done}
        wait(running, patience, FIRST_COMPLETED)
        return []


@dataclass(frozen=True)
class PathResult:
    """The results for one file."""

    signature: Signature
    picture: bytes | None
    """A picture of the surface; None if none was asked for."""


@dataclass(frozen=True)
class SignatureFile:
    """The signature of a mesh file, or its form at full resolution, as a file."""

    data: bytes
    warnings: Sequence[str]


def compute_path(
    path: Path,
    parameters: Parameters,
    policy: MeshPolicy | None,
    picture: PictureRequest | None = None,
    *,
    threads: int = 1,
) -> PathResult:
    """Return the signature of the mesh at `path`, and the requested picture of its surface."""
    found = signature_of_file(path, parameters, policy, threads=threads)
    return PathResult(found.signature, render_picture(picture, found.surface, threads=threads) if picture else None)


def dimensions_of_path(
    path: Path, parameters: Parameters, policy: MeshPolicy | None, *, threads: int = 1
) -> dict[Method, Floats]:
    """Return `moments_over_dimensions` of the mesh at `path`."""
    return moments_over_dimensions(read_mesh(path, policy=policy), parameters, threads=threads)


def compute_signature_file(
    path: Path, parameters: Parameters, policy: MeshPolicy, file_type: str, *, whole: bool = False, threads: int = 1
) -> SignatureFile:
    """Return the signature of the mesh at `path`, or with `whole` its form at full resolution, as a file."""
    found = signature_of_file(path, parameters, policy, threads=threads)
    if whole:
        data = export_form(canonical_form(found.surface, signature=found.signature, threads=threads), file_type)
    else:
        data = export_signature(found.signature, file_type)
    return SignatureFile(data, found.signature.warnings)


def compute_paths(
    paths: Sequence[Path],
    parameters: Parameters,
    policy: MeshPolicy | None = None,
    *,
    picture: PictureRequest | None = None,
    workers: int | None = None,
    memory_mb: int | None = None,
) -> Iterator[tuple[int, PathResult | UnbendError]]:
    """Yield the place in `paths`, and the signature and the requested picture, or the error, of each path."""
    compute = partial(compute_path, picture=picture)
    return compute_each(compute, paths, parameters, policy, workers=workers, memory_mb=memory_mb)


def compute_each(
    compute: Callable[..., T],
    paths: Sequence[Path],
    parameters: Parameters,
    policy: MeshPolicy | None = None,
    *,
    workers: int | None = None,
    memory_mb: int | None = None,
) -> Iterator[tuple[int, T | UnbendError]]:
    """Yield the place in `paths` and the result of `compute`, or the error, of each path, nearly in order."""
    with Batch(workers, memory_mb, len(paths)) as batch:
        run = partial(compute, threads=batch.threads)
        started = ((place, batch.submit(run, path, parameters, policy)) for place, path in enumerate(paths))
        for ready in batch.settled(started):
            for place, future in ready:
                outcome = outcome_of(future)
                yield place, outcome


def outcome_of(future: Future[T]) -> T | UnbendError:
    """Return the result of a done future, or its error."""
    error = future.exception()
    if isinstance(error, UnbendError):
        return error
    return future.result()
