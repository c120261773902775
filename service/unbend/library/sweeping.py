"""The sweep of an object store: objects without a mesh, meshes without an object, and moves between the two places."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Final, Literal

from sqlalchemy import ColumnElement, Connection, exists, func, select, true, update

from unbend.errors import ParameterError, StoreError
from unbend.library import Library
from unbend.library.storage import object_rows
from unbend.library.storage.log_eraser import mark_erased
from unbend.library.storage.object_deletions import ObjectDeletions
from unbend.library.storage.objects import FOLDERS, Objects, StoredObject
from unbend.library.storage.schema import meshes, object_deletions, object_writes

GRACE: Final = timedelta(days=1)
"""Age at which an object without a mesh is one that nobody needs."""

WRITE: Final = timedelta(hours=1)
"""Age at which a write counts as that of a dead process; far above the time of an upload."""

_PAGE: Final = 500

Home = Literal["objects", "database"]


@dataclass(frozen=True)
class Sweep:
    """The result of a sweep."""

    objects: int = 0
    """Number of objects."""
    size: int = 0
    """Bytes of all objects."""
    orphans: Sequence[str] = ()
    """Hashes of the objects, older than the grace time, that no mesh needs."""
    orphan_size: int = 0
    """Bytes of these objects."""
    missing: Sequence[str] = ()
    """Hashes of the meshes whose objects are missing."""
    deleted: int = 0
    """Number of deleted objects."""

    def with_folder(self, found: _Folder) -> Sweep:
        """Return the result with that of one more folder."""
        return replace(
            self,
            objects=self.objects + found.objects,
            size=self.size + found.size,
            orphans=[*self.orphans, *(each.sha256 for each in found.orphans)],
            orphan_size=self.orphan_size + sum(each.size for each in found.orphans),
            missing=[*self.missing, *found.missing],
        )


@dataclass
class _Folder:
    objects: int = 0
    size: int = 0
    orphans: list[StoredObject] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)


def sweep(library: Library, *, delete: bool = False, grace: timedelta = GRACE) -> Sweep:
    """Compare the object store with the database, while others use both.

    Parameters
    ----------
    library : Library
        A library with an object store.
    delete : bool, default False
        Delete the objects that no mesh needs. Never do this if another library shares the prefix.
    grace : timedelta, default one day
        Only older objects count as unneeded.

    Raises
    ------
    ParameterError
        If the library was opened without an object store.
    StoreError
        If the database or the object store fails.
    """
    objects, deletions = _parts(library)
    tidy(library)
    found, folders = Sweep(), objects.folders()
    for folder in FOLDERS:
        listed = objects.list(folder) if folder in folders else ()
        found = found.with_folder(_compare(library, objects, folder, listed, datetime.now(UTC) - grace))
    if delete and found.orphans:
        for start in range(0, len(found.orphans), _PAGE):
            library.store.change(partial(_queue, hashes=found.orphans[start : start + _PAGE]))
        deletions.run()
        left = library.store.load(partial(_queued, hashes=found.orphans))
        found = replace(found, deleted=len(found.orphans) - left)
    return found


def tidy(library: Library, *, longest: timedelta = WRITE) -> int:
    """End writes of dead processes, and carry out queued deletions; return the number of deleted objects.

    A write longer than `longest` counts as that of a dead process. This deletes only objects that the database names,
    so it needs no list of the object store. Raises as `sweep` does.
    """
    _, deletions = _parts(library)
    while library.store.change(partial(object_rows.end_old_writes, before=datetime.now(UTC) - longest)):
        pass
    return deletions.run()


def move(library: Library, home: Home) -> Iterator[tuple[str, int]]:
    """Move the files of all meshes into the object store, or into the database; yield each hash with its size.

    Each file is checked against its hash before its old copy goes. An interrupted move continues with the next call.
    Raises as `sweep` does; ObjectMissingError or ObjectDamagedError if an object cannot be moved.
    """
    objects, deletions = _parts(library)
    transfer = _to_objects if home == "objects" else partial(_to_database, objects)
    last = ""
    while page := library.store.load(partial(_page, home=home, last=last)):
        for sha256, size in page:
            transfer(library, sha256)
            yield sha256, size
        last = page[-1][0]
    deletions.run()


def _parts(library: Library) -> tuple[Objects, ObjectDeletions]:
    store = library.store
    if store.objects is None or store.deletions is None:
        raise ParameterError("the library was opened without an object store").with_advice(
            "Name it by --objects or UNBEND_OBJECTS."
        )
    return store.objects, store.deletions


def _compare(
    library: Library, objects: Objects, folder: str, items: Iterable[StoredObject], before: datetime
) -> _Folder:
    """Compare one folder. Whatever differs is looked at again, because others write meanwhile."""
    named = library.store.load(partial(_named, folder=folder))  # first: a later mesh has its object already
    found, listed = _Folder(), set()
    for item in items:
        listed.add(item.sha256)
        found.objects += 1
        found.size += item.size
        if item.sha256 not in named and item.modified < before:
            found.orphans.append(item)
    spared = library.store.load(partial(_spared, hashes=[each.sha256 for each in found.orphans]))
    found.orphans = [each for each in found.orphans if each.sha256 not in spared]
    for sha256 in sorted(named - listed):
        is_needed = library.store.load(partial(_is_needed, sha256=sha256))
        if is_needed and not objects.has(sha256):
            found.missing.append(sha256)
    return found


def _named(connection: Connection, folder: str) -> set[str]:
    """Return the hashes of a folder whose meshes are in the object store."""
    in_folder = meshes.c.sha256.startswith(folder, autoescape=True)
    return set(connection.scalars(select(meshes.c.sha256).where(in_folder, meshes.c.data.is_(None))))


def _spared(connection: Connection, hashes: Sequence[str]) -> set[str]:
    """Return those of some hashes that a mesh needs, a process writes, or whose deletion is queued already."""
    found: set[str] = set()
    for start in range(0, len(hashes), _PAGE):
        page = hashes[start : start + _PAGE]
        for column, condition in (
            (meshes.c.sha256, meshes.c.data.is_(None)),
            (object_writes.c.sha256, true()),
            (object_deletions.c.sha256, true()),
        ):
            found.update(connection.scalars(select(column).where(column.in_(page), condition)))
    return found


def _is_needed(connection: Connection, sha256: str) -> bool:
    return bool(connection.scalar(select(exists().where(meshes.c.sha256 == sha256, meshes.c.data.is_(None)))))


def _queue(connection: Connection, hashes: Sequence[str]) -> None:
    for sha256 in sorted(hashes):
        object_rows.queue_deletion(connection, sha256)


def _queued(connection: Connection, hashes: Sequence[str]) -> int:
    """Return how many of some deletions still wait."""
    waiting = set(connection.scalars(select(object_deletions.c.sha256)))
    return len(waiting.intersection(hashes))


def _page(connection: Connection, home: Home, last: str) -> list[tuple[str, int]]:
    """Return the next meshes that are not at their new home."""
    wanted = select(meshes.c.sha256, meshes.c.size).where(_elsewhere(home), meshes.c.sha256 > last)
    rows = connection.execute(wanted.order_by(meshes.c.sha256).limit(_PAGE))
    return [(row.sha256, row.size) for row in rows]


def _elsewhere(home: Home) -> ColumnElement[bool]:
    return meshes.c.data.is_not(None) if home == "objects" else meshes.c.data.is_(None)


def count_elsewhere(library: Library, home: Home) -> int:
    """Return the number of meshes that `move` would move."""
    wanted = select(func.count()).select_from(meshes).where(_elsewhere(home))
    return library.store.load(lambda connection: connection.scalar(wanted) or 0)


def _to_objects(library: Library, sha256: str) -> None:
    def read() -> bytes:
        data = library.files.read(sha256)
        if hashlib.sha256(data).hexdigest() != sha256:
            raise StoreError(f"mesh {sha256} in the database has other bytes than its hash")
        return data

    def change(connection: Connection, keep: Callable[[Connection], None]) -> None:
        del keep  # the row exists
        this = (meshes.c.sha256 == sha256) & meshes.c.data.is_not(None)
        connection.execute(update(meshes).where(this).values(data=None))
        mark_erased(connection, "soon")

    library.files.submit(sha256, read, change).result()


def _to_database(objects: Objects, library: Library, sha256: str) -> None:
    data = objects.get(sha256)

    def change(connection: Connection) -> None:
        this = (meshes.c.sha256 == sha256) & meshes.c.data.is_(None)
        if connection.execute(update(meshes).where(this).values(data=data)).rowcount:
            object_rows.queue_deletion(connection, sha256)

    library.store.change(change)


def count_waiting(library: Library) -> tuple[int, int]:
    """Return the numbers of writes under way and of queued deletions."""

    def load(connection: Connection) -> tuple[int, int]:
        writes, deletions = (
            connection.scalar(select(func.count()).select_from(table)) or 0
            for table in (object_writes, object_deletions)
        )
        return writes, deletions

    return library.store.load(load)


__all__ = ["GRACE", "Home", "Sweep", "count_elsewhere", "count_waiting", "move", "sweep", "tidy"]
