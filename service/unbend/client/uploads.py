"""Meshes and their descriptions as multipart requests. Files are read while they are sent."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, TypedDict

from unbend.client.protocol import Json, given
from unbend.errors import MeshReadError, ParameterError
from unbend.mesh.policy import PolicyLike
from unbend.mesh.sources import MeshSource, bytes_of, opened
from unbend.names import MAX_TEXT, printable
from unbend.signature.parameters import ParametersLike

UploadProgress = Callable[[int, int], None]
"""Called with the number of bytes that are sent, and of all bytes to send."""


class Content(TypedDict, total=False):
    """The body of a multipart request, as httpx takes it."""

    files: dict[str, tuple[str, Any]]
    data: dict[str, str]


class MeshFile:
    """A mesh to send, as a named binary file that reports how much of it was read. Close it after the request.

    A repeated request reads it again from its beginning. A file that grows or shrinks meanwhile cannot be sent, because
    the head of the request has its size.
    """

    def __init__(self, file: BinaryIO, name: str, progress: UploadProgress | None = None) -> None:
        self._file = file
        self._size = file.seek(0, io.SEEK_END)
        file.seek(0)
        self._progress = progress
        name = printable(name)
        self.name = name or "unnamed"
        # A server takes what follows a \\ for the name of a file, so the name of such a shape is sent on its own.
        self.title = Path(name).stem[:MAX_TEXT] if "\\" in name else None

    @classmethod
    def of(cls, source: MeshSource, progress: UploadProgress | None = None) -> Self:
        """Return the file of a mesh. A file named by its path is opened and not read yet; see `bytes_of`."""
        if isinstance(source, str | PathLike):
            path = Path(source)
            return cls(opened(path), path.name, progress)
        file = bytes_of(source)
        return cls(io.BytesIO(file.data), file.name, progress)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes, and report how many were read.

        Raises
        ------
        MeshReadError
            If the file has grown or shrunk since it was opened.
        """
        piece = self._file.read(size)
        place = self._file.tell()
        if place > self._size or (not piece and place < self._size):
            raise MeshReadError(f"{self.name} changed while it was sent")
        if self._progress and piece:
            self._progress(place, self._size)
        return piece

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Move within the file."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the place in the file."""
        return self._file.tell()


@dataclass(frozen=True)
class Details:
    """The description of an uploaded shape; fields that are None are not sent.

    Raises
    ------
    ParameterError
        If the name or the label is empty: a service takes an empty field of a form for one that is not given.
    """

    name: str | None
    label: str | None
    metadata: Mapping[str, Any] | None
    parameters: ParametersLike
    policy: PolicyLike
    if_known: str

    def __post_init__(self) -> None:
        for name, text in {"name": self.name, "label": self.label}.items():
            if text == "":
                raise ParameterError(f"a shape's {name} must not be empty")

    def content(self, mesh: MeshFile) -> Content:
        """Return the multipart form of an upload."""
        return _content(mesh, **vars(self) | {"name": mesh.title if self.name is None else self.name})


@dataclass(frozen=True)
class QueryOptions:
    """The options of a query; fields that are None have the service's defaults."""

    measure: str | None
    classifier: str | None
    k: int
    exact: bool | None = None
    label: str | None = None
    metadata: Mapping[str, Any] | None = None

    def content(self, mesh: MeshFile, parameters: ParametersLike, policy: PolicyLike) -> Content:
        """Return the multipart form of a query by file."""
        return _content(mesh, **vars(self), parameters=parameters, policy=policy)

    def of_shape(self, shape_id: str) -> Json:
        """Return the body of a query by a stored shape."""
        return {"shape_id": shape_id} | {name: value for name, value in vars(self).items() if value is not None}


def _content(mesh: MeshFile, **fields: object) -> Content:
    return {"files": {"file": (mesh.name, mesh)}, "data": given(**fields)}
