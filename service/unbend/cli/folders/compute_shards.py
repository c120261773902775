"""The computation of files into a shard, on all cores and without a library."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from unbend import __version__
from unbend.cli.folders.account import Ended
from unbend.cli.folders.files import LabelledFile, folder_name
from unbend.cli.folders.first_paths import FirstPaths
from unbend.cli.folders.import_into_library import read_again
from unbend.cli.folders.import_options import ImportOptions, description_of
from unbend.cli.folders.import_tasks import Task, completed, failed
from unbend.cli.folders.sharding import path_within
from unbend.errors import MeshReadError, ParameterError, UnbendError
from unbend.jobs.batch import Batch, outcome_of
from unbend.library.computed import compute_file
from unbend.library.requests import ShapeRequest, UploadKey
from unbend.library.shape_rows import ComputedShape
from unbend.library.shards.index import ShardIndex
from unbend.library.shards.numbering import ShardNumber
from unbend.library.shards.records import FileRecord, encode_shape
from unbend.library.shards.writer import ShardWriter
from unbend.mesh.policy import MeshPolicy
from unbend.names import shape_name
from unbend.signature.parameters import Parameters

Found = UploadKey | ComputedShape
"""The key of results that are written already, or the results for another file."""


def compute_shard(
    folder: Path, output: Path, shard: ShardNumber, files: Iterator[LabelledFile], count: int, options: ImportOptions
) -> Generator[Ended]:
    """Write the results of `count` files of a shard of `folder` to `output`; yield each file once it is on disk.

    Raises
    ------
    ParameterError
        If options are invalid.
    ResultsError
        If an earlier file of the shard is damaged, or another process writes the shard.
    OSError
        If a file cannot be written.
    """
    options.check()
    machine = options.machine
    with (
        ShardIndex() as known,
        FirstPaths() as firsts,
        Batch(machine.workers, machine.memory_mb, count) as batch,
        ShardWriter(output, shard, {"unbend": __version__}) as writer,
    ):
        for path in writer.finished():
            known.add_shard(path)
        for entry in writer.earlier():
            known.add(entry)
        computer = _Computer(folder, known, firsts, batch, options)
        for ready in batch.settled(map(computer.start, files)):
            ended = [computer.write(writer, task, future) for task, future in ready]
            writer.flush()  # once for all that are ready
            yield from ended


class _Computer:
    """Starts the computation of files without results, and writes the results."""

    def __init__(
        self, folder: Path, known: ShardIndex, firsts: FirstPaths, batch: Batch, options: ImportOptions
    ) -> None:
        self._folder, self._known, self._firsts, self._batch, self._options = folder, known, firsts, batch, options
        self._running: dict[UploadKey, Future[Found]] = {}

    def start(self, file: LabelledFile) -> tuple[Task, Future[Found]]:
        """Return the task of a file, and the future of its results. Files with equal keys share a future."""
        options = self._options
        try:
            parameters = Parameters.from_dict(options.parameters_of(file))
            policy = MeshPolicy.from_dict(options.policy_of(file))
            request = ShapeRequest.of(shape_name(file.path.name), description_of(file))
            sha256, content = options.content_of(file)
        except (ParameterError, MeshReadError) as error:
            return Task(file), failed(error)
        key = UploadKey.of(sha256, parameters, policy)
        task = Task(file, key, request, self._firsts.put(content, file.path))
        if key not in self._running:
            if self._known.has_shape(key):
                return task, completed(key)
            compute = partial(compute_file, parts=options.with_parts, threads=self._batch.threads)
            self._running[key] = self._batch.submit(compute, file.path, parameters, policy)
        return task, self._running[key]

    def write(self, writer: ShardWriter, task: Task, future: Future[Found]) -> Ended:
        """Write what is new of a file, and say what happened to it."""
        found = outcome_of(future)
        if task.key:
            self._running.pop(task.key, None)
        if isinstance(found, UnbendError):
            return Ended(task.path, "failed", str(found))
        warnings = found.signature.warnings if isinstance(found, ComputedShape) else ()
        key = found.key if isinstance(found, ComputedShape) else found
        is_new = not self._known.has_shape(key)
        if isinstance(found, ComputedShape) and is_new:
            try:
                mesh = read_again(task.path, key.sha256)
            except (MeshReadError, OSError) as error:
                return Ended(task.path, "failed", str(error))
            writer.append(encode_shape(found, mesh))
            self._known.put_shape(key)
        before = self._describe(writer, task, key)
        ended = partial(Ended, task.path, warnings=warnings)
        if task.first and not is_new:
            return ended("merged", str(task.first))
        if before is None or is_new:
            return ended("new")
        return ended("changed" if before else "unchanged", taken=before)

    def _describe(self, writer: ShardWriter, task: Task, key: UploadKey) -> list[str] | None:
        """Write the record of a file if it is new or different; return what differs, None if the file is new."""
        file, path = task.file, path_within(task.path, self._folder).as_posix()
        record = FileRecord(
            path, key, folder_name(file.path), file.label, file.name, file.metadata, file.is_row, time.time()
        )
        before = self._known.file(path, key)
        if before and (before.key, before.description) == (record.key, record.description):
            return []
        writer.append(record.encode())
        self._known.put(record)
        if before is None or before.key != record.key:
            return None
        return [name for name in ("name", "label", "metadata") if getattr(before, name) != getattr(record, name)]
