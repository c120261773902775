"""Changes to a copy of a backup before it replaces a library: the library's API keys, a new epoch, requeued jobs."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, delete, insert, select, update

from unbend.library import job_rows
from unbend.library.storage.schema import api_keys, library_state
from unbend.library.storage.store import Store

KeyRows = Sequence[Mapping[str, Any]]
"""Rows of `api_keys`."""


class KeysChangedError(Exception):
    """The library's keys changed while a backup was prepared."""


def prepare(staged: Path, store: Store) -> KeyRows:
    """Prepare a copy of a backup to replace the content of `store`, and return the keys of `store`.

    The copy is migrated to the present schema, and gets these keys if there are any.
    """
    keys = _keys_of(store)

    def change(connection: Connection) -> None:
        if keys:  # otherwise the keys of the backup stay: they can only restrict access
            connection.execute(delete(api_keys))
            connection.execute(insert(api_keys), [dict(key) for key in keys])
        for job in job_rows.running_jobs(connection):
            job_rows.requeue(connection, job, cause="stopped")
        connection.execute(update(library_state).values(epoch=uuid.uuid4().hex))

    with closing(Store(str(staged))) as copy:
        copy.change(change)
    return keys


def check_keys(store: Store, keys: KeyRows) -> None:
    """Raise KeysChangedError if the keys of `store` have changed."""
    if _keys_of(store) != keys:
        raise KeysChangedError


def _keys_of(store: Store) -> KeyRows:
    with store.read() as connection:
        return _keys(connection)


def _keys(connection: Connection) -> KeyRows:
    return [dict(row) for row in connection.execute(select(api_keys).order_by(api_keys.c.id)).mappings()]
