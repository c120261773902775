"""The bytes of meshes: in the database, or in an object store. The database is the truth about both."""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import BinaryIO, Final, TypeVar

from sqlalchemy import Connection

from unbend.errors import ObjectMissingError, ObjectsUnavailableError, StoreError
from unbend.library import shape_rows
from unbend.library.storage import object_rows
from unbend.library.storage.objects import Objects
from unbend.library.storage.store import Store

T = TypeVar("T")

Keep = Callable[[Connection], None]
"""Adds the row of a mesh within a transaction, unless there is one."""

Open = Callable[[], bytes | BinaryIO]
"""Returns the content of a file, or the file."""

_WRITERS: Final = 4
"""Largest number of files that are sent to the object store at a time."""
_NEAR_PIECE: Final = 2**18
_FAR_PIECE: Final = 2**21
_WAIT_SECONDS: Final = 10.0
"""Longest wait for the end of a deletion of the same bytes."""
_PAUSE: Final = 0.05


class MeshFiles:
    """The files of meshes; thread-safe."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._writers = ThreadPoolExecutor(_WRITERS, thread_name_prefix="unbend objects")

    @property
    def are_in_database(self) -> bool:
        """Whether new files go into the database."""
        return self._store.objects is None

    @property
    def piece_bytes(self) -> int:
        """The number of bytes that a stream of a file reads at a time: more from an object store, which is farther."""
        return _NEAR_PIECE if self.are_in_database else _FAR_PIECE

    def submit(self, sha256: str, open_file: Open, change: Callable[[Connection, Keep], T]) -> Future[T]:
        """Queue a change that may need the file of a mesh; the future has its result once all is on disk.

        Parameters
        ----------
        sha256 : str
        open_file : callable
            Called in another thread.
        change : callable
            Runs in a transaction. It calls its second argument before it adds a row that refers to the mesh. If it does
            not, the file is not kept.

        Raises
        ------
        StoreError
            From the future, as by `Store.submit`; ObjectsUnavailableError if the object store fails.
        """
        objects = self._store.objects
        if objects is None:
            return self._store.submit(lambda connection: change(connection, partial(_keep_bytes, sha256, open_file)))
        return self._writers.submit(self._write, objects, sha256, open_file, change)

    def read(self, sha256: str) -> bytes:
        """Return a file; NotFoundError if there is none with this hash; errors of objects as by `fetch`."""
        data = self._store.load(partial(shape_rows.get_file, sha256=sha256))
        return self.fetch(sha256) if data is None else data

    def fetch(self, sha256: str) -> bytes:
        """Return a file that is in the object store.

        Raises
        ------
        NotFoundError
            If the mesh was removed meanwhile.
        ObjectsUnavailableError
            If the object store fails, or is not known; ObjectMissingError if the object is missing.
        ObjectDamagedError
            If the object has other bytes.
        """
        try:
            return self._objects(sha256).get(sha256)
        except ObjectMissingError:
            data = self._store.load(partial(shape_rows.get_file, sha256=sha256))
            if data is None:
                raise
            return data  # moved to the database meanwhile

    def read_range(self, sha256: str, offset: int, size: int) -> bytes:
        """Return at most `size` bytes of a file from `offset`; raises as `read`, but does not check the bytes."""
        read = partial(shape_rows.read_file_range, sha256=sha256, offset=offset, size=size)
        piece = self._store.load(read)
        if piece is not None:
            return piece
        try:
            return self._objects(sha256).get_range(sha256, offset, size)
        except ObjectMissingError:
            piece = self._store.load(read)
            if piece is None:
                raise
            return piece

    def close(self) -> None:
        """Wait for the files that are being sent."""
        self._writers.shutdown()

    def _objects(self, sha256: str) -> Objects:
        if self._store.objects is None:
            raise ObjectsUnavailableError(f"mesh {sha256} is in an object store, and none is named").with_advice(
                "Name the object store of the library by --objects or UNBEND_OBJECTS."
            )
        return self._store.objects

    def _write(self, objects: Objects, sha256: str, open_file: Open, change: Callable[[Connection, Keep], T]) -> T:
        """Put a file, and run the change that needs it (see `object_rows`)."""
        token = uuid.uuid4().hex
        size = self._begin(token, sha256)
        try:
            if size is None:
                size = objects.put(sha256, open_file())
            keep = partial(object_rows.keep, token=token, sha256=sha256, size=size)

            def run(connection: Connection) -> T:
                result = change(connection, keep)
                object_rows.end_write(connection, token, sha256)
                return result

            return self._store.change(run)
        except BaseException:
            with contextlib.suppress(StoreError):  # `end_old_writes` ends it later
                self._store.change(partial(object_rows.end_write, token=token, sha256=sha256))
            raise

    def _begin(self, token: str, sha256: str) -> int | None:
        deadline = time.monotonic() + _WAIT_SECONDS
        while True:
            try:
                return self._store.change(partial(object_rows.begin_write, token=token, sha256=sha256))
            except object_rows.DeletionRunsError as error:
                if time.monotonic() > deadline:
                    raise ObjectsUnavailableError(str(error)) from None
            time.sleep(_PAUSE)


def _keep_bytes(sha256: str, open_file: Open, connection: Connection) -> None:
    content = open_file()
    if not isinstance(content, bytes):
        content.seek(0)
        content = content.read()
    shape_rows.put_mesh(connection, sha256, content)
