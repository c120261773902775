"""Rows about objects: writes under way, and deletions that wait. They decide when an object may be deleted.

An object is needed while a mesh without bytes names it. Three rules keep such objects:

- A write has a row in `object_writes` before it touches the object store. The transaction that adds the mesh removes
  the row.
- A deletion is claimed in a transaction that sees neither a mesh nor a write of this hash. The object is deleted
  afterwards.
- A write does not begin while a deletion of its hash is claimed.

So no deletion runs between the moment in which a write finds or puts an object, and the commit that needs it. Nothing
waits for the object store within a transaction. The rows tell later processes what a killed process left.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Final

from sqlalchemy import Connection, bindparam, delete, exists, insert, select, update

from unbend.errors import StoreError
from unbend.library.storage.postgres import lock
from unbend.library.storage.schema import meshes, object_deletions, object_writes

_MARK: Final = "unbend_dropped"
_BATCH: Final = 100
CLAIM_SECONDS: Final = 300.0
"""Age after which the claim of a deletion counts as that of a dead process; far above the time of a deletion."""

_NEEDED = exists().where(meshes.c.sha256 == bindparam("sha256"), meshes.c.data.is_(None))
_WRITTEN = exists().where(object_writes.c.sha256 == bindparam("sha256"))
_GET_SIZE = select(meshes.c.size).where(meshes.c.sha256 == bindparam("sha256"), meshes.c.data.is_(None))
_HAS_MESH = select(exists().where(meshes.c.sha256 == bindparam("sha256")))
_HAS_TOKEN = select(exists().where(object_writes.c.token == bindparam("token")))
_GET_CLAIM = select(object_deletions.c.claimed_at).where(
    object_deletions.c.sha256 == bindparam("sha256"), object_deletions.c.claim.is_not(None)
)


class DeletionRunsError(Exception):
    """The object is being deleted at this moment. It is no StoreError, so that the store does not repeat the change."""


def begin_write(connection: Connection, token: str, sha256: str) -> int | None:
    """Announce a write of an object; return the size of the mesh if its object is there already, and stays.

    Raises
    ------
    DeletionRunsError
        If the object is being deleted: try again.
    """
    _lock(connection, sha256)
    claimed_at = connection.scalar(_GET_CLAIM, {"sha256": sha256})
    if claimed_at is not None and claimed_at > datetime.now(UTC) - timedelta(seconds=CLAIM_SECONDS):
        raise DeletionRunsError(f"the object of mesh {sha256} is being deleted")
    if claimed_at is not None:
        _unclaim(connection, object_deletions.c.sha256 == sha256)
    if not connection.scalar(_HAS_TOKEN, {"token": token}):  # otherwise an earlier run of this change was committed
        connection.execute(insert(object_writes).values(token=token, sha256=sha256, at=datetime.now(UTC)))
    return connection.scalar(_GET_SIZE, {"sha256": sha256})


def keep(connection: Connection, token: str, sha256: str, size: int) -> None:
    """Add the mesh of a written object, unless there is one.

    Raises
    ------
    StoreError
        If the write took so long that its object may be deleted.
    """
    _lock(connection, sha256)
    if connection.scalar(_HAS_MESH, {"sha256": sha256}):
        return
    if not connection.scalar(_HAS_TOKEN, {"token": token}):
        raise StoreError("the write to the object store took too long").with_advice("Send the file again.")
    connection.execute(insert(meshes).values(sha256=sha256, size=size, data=None))


def end_write(connection: Connection, token: str, sha256: str) -> None:
    """End a write; queue the deletion of its object if nothing needs it."""
    _lock(connection, sha256)
    if connection.execute(delete(object_writes).where(object_writes.c.token == token)).rowcount:
        queue_deletion(connection, sha256)


def queue_deletion(connection: Connection, sha256: str) -> None:
    """Queue the deletion of an object, unless a mesh needs it, or a write under way will decide."""
    _lock(connection, sha256)
    queued = exists().where(object_deletions.c.sha256 == bindparam("sha256"))
    if connection.scalar(select(_NEEDED | _WRITTEN | queued), {"sha256": sha256}):
        return
    connection.execute(insert(object_deletions).values(sha256=sha256, at=datetime.now(UTC)))
    connection.info[_MARK] = True


def take_dropped(connection: Connection) -> bool:
    """Return whether the transaction on this connection queued a deletion, and forget it."""
    return bool(connection.info.pop(_MARK, False))


def claim_deletions(connection: Connection, claim: str) -> Sequence[str]:
    """Claim queued deletions, and return their hashes; forget those that a mesh needs again."""
    dead = datetime.now(UTC) - timedelta(seconds=CLAIM_SECONDS)
    free = object_deletions.c.claim.is_(None) | (object_deletions.c.claimed_at < dead)
    of_entry = object_writes.c.sha256 == object_deletions.c.sha256
    entries = select(object_deletions.c.sha256).where(free, ~exists().where(of_entry))
    waiting = connection.scalars(entries.order_by(object_deletions.c.at).limit(_BATCH)).all()
    claimed = []
    for sha256 in sorted(waiting):  # in the same order in every process, so that none waits for another in a circle
        _lock(connection, sha256)
        this = object_deletions.c.sha256 == sha256
        if connection.scalar(select(_NEEDED), {"sha256": sha256}):
            connection.execute(delete(object_deletions).where(this))
        elif not connection.scalar(select(_WRITTEN), {"sha256": sha256}):
            made = update(object_deletions).where(this, free).values(claim=claim, claimed_at=datetime.now(UTC))
            if connection.execute(made).rowcount:
                claimed.append(sha256)
    return claimed


def finish_deletions(connection: Connection, claim: str) -> None:
    """Forget deletions that were carried out."""
    connection.execute(delete(object_deletions).where(object_deletions.c.claim == claim))


def release_deletions(connection: Connection, claim: str) -> None:
    """Return claimed deletions to the queue."""
    _unclaim(connection, object_deletions.c.claim == claim)


def end_old_writes(connection: Connection, before: datetime) -> int:
    """End some writes that began before an instant, because their processes died; return their number."""
    old = select(object_writes.c.token, object_writes.c.sha256).where(object_writes.c.at < before).limit(_BATCH)
    rows = sorted(connection.execute(old), key=lambda row: row.sha256)
    for row in rows:
        end_write(connection, row.token, row.sha256)
    return len(rows)


def _unclaim(connection: Connection, which: object) -> None:
    connection.execute(update(object_deletions).where(which).values(claim=None, claimed_at=None))  # type: ignore[arg-type]


def _lock(connection: Connection, sha256: str) -> None:
    lock(connection, f"object {sha256}")
