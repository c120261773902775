"""A file that is imported or computed: its key, its request, and what happened to it in the end."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from unbend.cli.folders.account import Ended
from unbend.cli.folders.files import LabelledFile
from unbend.cli.folders.import_options import kept_class
from unbend.library.requests import ShapeRequest, UploadKey
from unbend.results.shapes import AddedShape

T = TypeVar("T")


@dataclass(frozen=True)
class Task:
    """A file whose shape is known or being computed."""

    file: LabelledFile
    key: UploadKey | None = None
    request: ShapeRequest | None = None
    first: Path | None = None
    """An earlier file that is the same shape."""

    @property
    def path(self) -> Path:
        """The path of the file."""
        return self.file.path

    def ended(self, shape: AddedShape) -> Ended:
        """Return what happened to the file, whose shape is stored."""
        ended = partial(
            Ended, self.path, result=shape.id, taken=shape.updated, ignored=shape.ignored, warnings=shape.warnings
        )
        if shape.is_new:
            return ended("new")
        if self.first:
            return ended("merged", str(self.first))
        return ended("changed" if shape.updated else "unchanged", kept_class(self.file, shape))


def completed(result: T) -> Future[T]:
    """Return a future that has a result."""
    future: Future[T] = Future()
    future.set_result(result)
    return future


def failed(error: BaseException | None) -> Future[T]:
    """Return a future that has an error."""
    future: Future[T] = Future()
    future.set_exception(error)
    return future
