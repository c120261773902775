"""The cache of reads: it is valid until any process writes to the store."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing

from sqlalchemy import Connection

from tests.support.store import add
from unbend import Library
from unbend.library import shape_rows


def counted(library: Library, looks: list[int]):
    async def fetch() -> int:
        def look(connection: Connection) -> int:
            looks.append(1)
            return shape_rows.count_shapes(connection)

        return await library.store.fetch(look, "how many")

    return asyncio.run(fetch())


def test_a_read_is_cached_until_any_process_writes(tmp_path):
    path, looks = tmp_path / "library.db", []
    with Library(str(path)) as library, Library(str(path)) as other:
        assert [counted(library, looks) for _ in range(3)] == [0, 0, 0]
        assert len(looks) == 1
        add(library, b"one", "one")
        assert [counted(library, looks) for _ in range(3)] == [1, 1, 1]
        assert len(looks) == 2
        add(other, b"two", "two")
        assert counted(library, looks) == 2
        with closing(sqlite3.connect(path)) as connection, connection:
            connection.execute("DELETE FROM shapes")
        assert counted(library, looks) == 0
        assert len(looks) == 4


def test_a_library_in_memory_forgets_no_write():
    looks: list[int] = []
    with Library("sqlite://") as library:
        assert counted(library, looks) == 0
        add(library, b"one", "one")
        assert counted(library, looks) == 1
        record, text = library.keys.create("a", "read")
        assert asyncio.run(library.keys.find_async(text)) == (record, True)
        library.keys.revoke(record.id)
        assert asyncio.run(library.keys.find_async(text)) == (None, False)


def test_a_rolled_back_write_does_not_invalidate_the_cache(tmp_path):
    looks: list[int] = []
    with Library(str(tmp_path / "library.db")) as library:
        assert counted(library, looks) == 0
        with closing(sqlite3.connect(tmp_path / "library.db")) as connection:
            connection.execute("BEGIN IMMEDIATE")
            connection.execute("UPDATE library_state SET revision = 99")
            assert counted(library, looks) == 0
            connection.rollback()
        assert counted(library, looks) == 0
        assert len(looks) == 1
