"""The import of results that `unbend compute` has written."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import Final

from unbend.cli.folders.account import Ended
from unbend.cli.folders.first_paths import FirstPaths
from unbend.cli.folders.import_options import ImportOptions, description_of
from unbend.cli.folders.import_tasks import Task, completed, failed
from unbend.cli.folders.sharding import ComputedFile
from unbend.cli.options import chosen_objects
from unbend.errors import NotFoundError, StoreError, UnbendError
from unbend.library import Library
from unbend.library.computed import check_key
from unbend.library.requests import ShapeRequest, UploadKey
from unbend.library.shards.index import ShardIndex
from unbend.library.shards.records import read_mesh_of, read_shape
from unbend.names import shape_name
from unbend.results.shapes import AddedShape

_AHEAD: Final = 64
"""Most shapes that wait to be stored: so many share a transaction, and with it a wait for the disk."""


def import_shards(
    url: str, files: Iterator[ComputedFile], index: ShardIndex, options: ImportOptions
) -> Generator[Ended]:
    """Store the results of files, and yield each file once it is on disk.

    Raises
    ------
    StoreError
        If the library fails.
    """
    with Library(url, objects=chosen_objects()) as library, FirstPaths() as firsts:
        importer = _Importer(library, index, firsts, options)
        waiting: deque[tuple[Task, Future[AddedShape]]] = deque()
        for file in files:
            waiting.append(importer.start(file))
            if len(waiting) > _AHEAD:
                yield importer.end(*waiting.popleft())
        for task, stored in waiting:
            yield importer.end(task, stored)


class _Importer:
    """Stores the results of files whose shapes are not known."""

    def __init__(self, library: Library, index: ShardIndex, firsts: FirstPaths, options: ImportOptions) -> None:
        self._library, self._index, self._firsts, self._options = library, index, firsts, options

    def start(self, file: ComputedFile) -> tuple[Task, Future[AddedShape]]:
        """Return the task of a file, and the future of its shape."""
        key = file.record.key
        try:
            check_key(key)
            first = self._firsts.put("\0".join(vars(key).values()).encode(), file.path)
            if_known = self._options.if_known_of(first)
            request = ShapeRequest.of(shape_name(file.path.name), description_of(file), if_known)
            return Task(file, key, request, first), self._stored(key, request)
        except StoreError:
            raise
        except UnbendError as error:
            return Task(file), failed(error)

    def end(self, task: Task, stored: Future[AddedShape]) -> Ended:
        """Wait until a task is stored, and say what happened to its file."""
        try:
            return task.ended(stored.result())
        except StoreError:
            raise
        except UnbendError as error:
            return Ended(task.path, "failed", str(error))

    def _stored(self, key: UploadKey, request: ShapeRequest) -> Future[AddedShape]:
        shapes = self._library.shapes
        if known := shapes.find(key):
            try:
                return completed(shapes.update_known(known, request))
            except NotFoundError:
                raise UnbendError("its shape was removed while it was imported: import it again") from None
        entry = self._index.shape(key)
        if entry is None:
            raise UnbendError("the shards that were read have no results for this file: compute it again")
        computed = read_shape(entry)
        if not self._options.with_parts:
            computed = replace(computed, signature=replace(computed.signature, local=None))
        return shapes.submit(computed, request, partial(read_mesh_of, entry))
