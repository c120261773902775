"""The shapes of a library: read, changed and removed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Hashable, Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any, TypeVar, get_args

from sqlalchemy import Connection

from unbend.errors import ParameterError, check_choice
from unbend.library import shape_rows
from unbend.library.mesh_files import Keep, MeshFiles, Open
from unbend.library.metadata import check_changes
from unbend.library.requests import ShapeRequest, UploadKey
from unbend.library.shape_rows import ComputedShape
from unbend.library.storage.store import Store
from unbend.results.shapes import AddedShape, ShapeOrder, ShapePage, ShapeRecord
from unbend.signature.signature import Signature

T = TypeVar("T")


class Shapes:
    """The stored shapes, their files and signatures; thread-safe.

    Methods that end in `_async` wait without blocking the event loop.
    """

    def __init__(self, store: Store, files: MeshFiles) -> None:
        self._store = store
        self._files = files

    def __len__(self) -> int:
        return self._store.load(shape_rows.count_shapes)

    def get(self, shape_id: str) -> ShapeRecord:
        """Return a shape; NotFoundError if there is none of this id."""
        return self._store.load(partial(shape_rows.get_shape, shape_id=shape_id))

    async def render_async(self, shape_id: str, render: Callable[[ShapeRecord], T]) -> T:
        """Return `render(shape)`, cached until somebody writes to the library."""
        key: Hashable = (render, shape_id)
        return await self._store.fetch(lambda connection: render(shape_rows.get_shape(connection, shape_id)), key)

    def find(self, key: UploadKey) -> ShapeRecord | None:
        """Return the shape with this key, if there is one."""
        return self._store.load(partial(shape_rows.find_shape, key=key))

    def page(
        self,
        *,
        label: str | None = None,
        sha256: str | None = None,
        name: str | None = None,
        order: ShapeOrder = "oldest",
        cursor: str | None = None,
        limit: int = 100,
    ) -> ShapePage:
        """Return up to `limit` (at most 500) shapes after `cursor`, in the order of adding or in reverse.

        Parameters
        ----------
        label : str, optional
            Only shapes of this class.
        sha256 : str, optional
            Only shapes made from the file with this hash.
        name : str, optional
            Only shapes whose name contains this text, in either case.
        order : {"oldest", "newest"}
            The shape that comes first.
        cursor : str, optional
            `next_cursor` of the page before, in the same order.
        limit : int, default 100

        Raises
        ------
        ParameterError
            If `limit` is below 1, `cursor` is no cursor, or there is no such order.
        """
        if limit < 1:
            raise ParameterError(f"limit must be at least 1, not {limit}")
        check_choice("order", order, get_args(ShapeOrder))
        wanted = partial(
            shape_rows.list_shapes, label=label, sha256=sha256, name=name, order=order, cursor=cursor, limit=limit
        )
        return self._store.load(wanted)

    def labels(self) -> dict[str, int]:
        """Return the number of shapes of each class."""
        return self._store.load(shape_rows.count_labels)

    def file(self, sha256: str) -> bytes:
        """Return a stored file; NotFoundError if there is none with this hash."""
        return self._files.read(sha256)

    def read_file(self, sha256: str, offset: int, size: int) -> bytes:
        """Return at most `size` bytes of a stored file from `offset`; NotFoundError if there is no such file."""
        return self._files.read_range(sha256, offset, size)

    def signature(self, shape_id: str) -> Signature:
        """Return a shape's signature; NotFoundError if there is no such shape."""
        return self._store.load(partial(shape_rows.get_signature, shape_id=shape_id))

    def without_local(self) -> list[ShapeRecord]:
        """Return the shapes without local signatures of this version."""
        return self._store.load(shape_rows.list_without_local)

    def set_local(self, shape_id: str, payload: bytes) -> None:
        """Store packed local signatures of a shape; do nothing if the shape was removed."""
        self._store.change(partial(shape_rows.put_local, shape_id=shape_id, payload=payload))

    def submit(self, computed: ComputedShape, request: ShapeRequest, read: Open) -> Future[AddedShape]:
        """Queue the storing of a file and its results; the future has the shape once it is on disk.

        If a shape with the file's key is stored already, this does as `update_known` does. `read` returns the file. It
        runs in another thread when the file is stored, so that queued files need no memory.
        """

        def add(connection: Connection, keep: Keep) -> AddedShape:
            if not self._files.are_in_database:
                shape_rows.lock_shapes(connection)  # before the lock of the object, as a removal does
            if known := shape_rows.find_shape(connection, computed.key):
                return shape_rows.update_known(connection, known, request)
            keep(connection)
            return AddedShape.of(shape_rows.add_shape(connection, computed, request), is_new=True)

        return self._files.submit(computed.key.sha256, read, add)

    def update_known(self, shape: ShapeRecord, request: ShapeRequest) -> AddedShape:
        """Change a known shape as `request` describes if its `if_known` is "update"; return what changed."""
        if not shape_rows.find_differences(shape, request):
            return AddedShape.of(shape, is_new=False)  # without waiting for the writer
        return self._store.change(partial(shape_rows.update_known, shape=shape, request=request))

    def change(self, shape_id: str, changes: Mapping[str, Any]) -> ShapeRecord:
        """Set some of a shape's name, label and metadata, and return the shape.

        Raises
        ------
        ParameterError
            If a value cannot be stored.
        NotFoundError
            If there is no such shape.
        """
        check_changes(changes)
        return self._store.change(partial(shape_rows.change_shape, shape_id=shape_id, changes=dict(changes)))

    async def change_async(
        self, shape_id: str, changes: Mapping[str, Any], expected: Collection[int] | None
    ) -> ShapeRecord:
        """Change a shape as `change` does; ChangedError if its last revision is not one of `expected`."""
        check_changes(changes)
        change = partial(shape_rows.change_shape, shape_id=shape_id, changes=dict(changes), expected=expected)
        return await asyncio.wrap_future(self._store.submit(change))

    def remove(self, shape_id: str) -> None:
        """Remove a shape, its signature and descriptors, and its file unless something else needs it.

        Raises NotFoundError if there is no such shape.
        """
        self._store.change(partial(shape_rows.remove_shape, shape_id=shape_id))

    async def remove_async(self, shape_id: str, expected: Collection[int] | None) -> None:
        """Remove a shape as `remove` does; ChangedError if its last revision is not one of `expected`."""
        change = partial(shape_rows.remove_shape, shape_id=shape_id, expected=expected)
        await asyncio.wrap_future(self._store.submit(change))
