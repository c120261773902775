"""The import of files into a library, on all cores."""

from __future__ import annotations

import hashlib
from collections.abc import Generator, Iterator
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from unbend.cli.folders.account import Ended
from unbend.cli.folders.files import LabelledFile
from unbend.cli.folders.first_paths import FirstPaths
from unbend.cli.folders.import_options import ImportOptions, description_of
from unbend.cli.folders.import_tasks import Task, completed, failed
from unbend.cli.options import chosen_objects
from unbend.errors import MeshReadError, NotFoundError, ParameterError, StoreError, UnbendError
from unbend.jobs.batch import Batch
from unbend.library import Library
from unbend.library.computed import compute_file
from unbend.library.requests import ShapeRequest, UploadKey
from unbend.library.shape_rows import ComputedShape
from unbend.mesh.policy import MeshPolicy
from unbend.names import shape_name
from unbend.results.shapes import AddedShape, ShapeRecord
from unbend.signature.parameters import Parameters

Found = ShapeRecord | ComputedShape
"""The stored shape of a known file, or the results for another file."""


def import_into_library(
    url: str, files: Iterator[LabelledFile], count: int, options: ImportOptions
) -> Generator[Ended]:
    """Store the shapes of `count` files, and yield each file once it is on disk.

    Raises
    ------
    ParameterError
        If options are invalid.
    StoreError
        If the library fails.
    """
    options.check()
    machine = options.machine
    with (
        Library(url, objects=chosen_objects()) as library,
        FirstPaths() as firsts,
        Batch(machine.workers, machine.memory_mb, count) as batch,
    ):
        importer = _Importer(library, batch, firsts, options)
        for ready in batch.settled(map(importer.start, files)):
            # All are queued before the first is waited for, so that they share a transaction.
            queued = [(task, importer.store(task, future)) for task, future in ready]
            for task, stored in queued:
                yield importer.end(task, stored)


class _Importer:
    """Starts the computation of files that are not known, and stores the results."""

    def __init__(self, library: Library, batch: Batch, firsts: FirstPaths, options: ImportOptions) -> None:
        self._library = library
        self._batch = batch
        self._firsts = firsts
        self._options = options
        self._running: dict[UploadKey, Future[Found]] = {}

    def start(self, file: LabelledFile) -> tuple[Task, Future[Found]]:
        """Return the task of a file, and the future of its shape or results. Files with equal keys share a future."""
        options = self._options
        try:
            parameters = Parameters.from_dict(options.parameters_of(file))
            policy = MeshPolicy.from_dict(options.policy_of(file))
            sha256, content = options.content_of(file)
            first = self._firsts.put(content, file.path)
            request = ShapeRequest.of(shape_name(file.path.name), description_of(file), options.if_known_of(first))
        except (ParameterError, MeshReadError) as error:
            return Task(file), failed(error)
        key = UploadKey.of(sha256, parameters, policy)
        task = Task(file, key, request, first)
        if key not in self._running:
            if known := self._library.shapes.find(key):
                return task, completed(known)
            compute = partial(compute_file, parts=options.with_parts, threads=self._batch.threads)
            self._running[key] = self._batch.submit(compute, file.path, parameters, policy)
        return task, self._running[key]

    def store(self, task: Task, future: Future[Found]) -> Future[AddedShape]:
        """Queue the storing of a task's results, or the change of its known shape."""
        if (error := future.exception()) or not task.request:
            return failed(error)
        found = future.result()
        if isinstance(found, ShapeRecord):
            try:
                return completed(self._library.shapes.update_known(found, task.request))
            except NotFoundError:
                return failed(UnbendError("its shape was removed while it was imported: import it again"))
        return self._library.shapes.submit(found, task.request, partial(read_again, task.path, found.key.sha256))

    def end(self, task: Task, stored: Future[AddedShape]) -> Ended:
        """Wait until a task is stored, and say what happened to its file."""
        try:
            return task.ended(stored.result())
        except StoreError:
            raise
        except (UnbendError, OSError) as error:
            return Ended(task.path, "failed", str(error))
        finally:
            if task.key:
                self._running.pop(task.key, None)


def read_again(path: Path, sha256: str) -> bytes:
    """Return the content of a file that workers have read before; MeshReadError if it is another."""
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != sha256:
        raise MeshReadError("the file changed since it was computed")
    return data
