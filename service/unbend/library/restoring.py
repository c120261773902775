"""What a backup is given before it takes a library's place: its keys, an epoch, jobs that can be taken up."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, delete, insert, select, update

from unbend.library import queue
from unbend.library.engine import Store
from unbend.library.schema import api_keys, library_state

Keys = Sequence[Mapping[str, Any]]
"""Rows of `api_keys`."""


class KeysChangedError(Exception):
    """A key was made or revoked while a backup was made ready."""


def prepare(staged: Path, store: Store) -> Keys:
    """Make a copy of a backup ready to take the place of `store`; return the keys of `store`, which it has now.

    The copy's schema is brought up to date.
    """
    keys = _keys_of(store)
    with closing(Store(str(staged))) as copy, copy.write() as connection:
        if keys:  # else the library was open, and the backup's keys can only close it
            connection.execute(delete(api_keys))
            connection.execute(insert(api_keys), [dict(key) for key in keys])
        for job in queue.running_jobs(connection):
            queue.give_back(connection, job.id, lost="nothing")
        connection.execute(update(library_state).values(epoch=uuid.uuid4().hex))
    return keys


def check_keys(store: Store, keys: Keys) -> None:
    """Raise KeysChangedError if the keys of `store` are others by now."""
    if _keys_of(store) != keys:
        raise KeysChangedError


def _keys_of(store: Store) -> Keys:
    with store.read() as connection:
        return _keys(connection)


def _keys(connection: Connection) -> Keys:
    return [dict(row) for row in connection.execute(select(api_keys).order_by(api_keys.c.id)).mappings()]
