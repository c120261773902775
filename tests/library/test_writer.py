"""The writer of a store: the order of changes, failing changes, and shared transactions."""

from __future__ import annotations

import threading
from concurrent.futures import CancelledError
from functools import partial

import pytest
from sqlalchemy import Connection

from tests.support.store import insert
from unbend import Library
from unbend.errors import NotFoundError, StoreFullError


@pytest.fixture
def library(tmp_path):
    with Library(str(tmp_path / "library.db")) as opened:
        yield opened


@pytest.fixture
def writer(library):
    return library.store


def put(connection: Connection, name: str) -> str:
    return insert(connection, name.encode(), name).id


def spoil(connection: Connection, name: str) -> None:
    put(connection, name)
    raise NotFoundError(f"no {name}")


def names(library: Library) -> list[str]:
    return [shape.name for shape in library.page().items]


def test_a_change_is_in_the_store_when_its_future_has_a_result(library, writer):
    shape_id = writer.submit(partial(put, name="one")).result(10)
    assert library.get(shape_id).name == "one"


def test_changes_of_one_transaction_run_in_order_and_fail_separately(library, writer):
    held, go_on = threading.Event(), threading.Event()

    def hold(connection: Connection) -> None:
        held.set()
        assert go_on.wait(10)
        put(connection, "held")

    begun = writer.submit(hold)
    assert held.wait(10)
    changes = [spoil if number % 3 == 1 else put for number in range(9)]
    waiting = [writer.submit(partial(change, name=f"n{number}")) for number, change in enumerate(changes)]
    given_up = writer.submit(partial(put, name="given up"))
    assert given_up.cancel()
    go_on.set()
    begun.result(10)
    for number, future in enumerate(waiting):
        if number % 3 == 1:
            with pytest.raises(NotFoundError, match=f"no n{number}"):
                future.result(10)
        else:
            assert library.get(future.result(10)).name == f"n{number}"
    with pytest.raises(CancelledError):
        given_up.result(10)
    assert names(library) == ["held", *(f"n{number}" for number in range(9) if number % 3 != 1)]


def test_a_failed_change_leaves_nothing_and_the_writer_continues(library, writer):
    with pytest.raises(NotFoundError):
        writer.submit(partial(spoil, name="spoilt")).result(10)
    writer.submit(partial(put, name="after")).result(10)
    assert names(library) == ["after"]


def test_changes_submitted_before_closing_are_written(tmp_path):
    with Library(str(tmp_path / "closed.db")) as library:
        futures = [library.store.submit(partial(put, name=str(number))) for number in range(200)]
    assert all(future.done() for future in futures)
    with Library(str(tmp_path / "closed.db")) as library:
        assert len(library) == 200


def fill(connection: Connection, name: str) -> str:
    """Exceed the size limit of the database: SQLite then rolls the whole transaction back, as on a full disk."""
    pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
    connection.exec_driver_sql(f"PRAGMA max_page_count = {pages + 4}")
    try:
        return put(connection, name + "x" * 2**20)
    finally:
        connection.exec_driver_sql("PRAGMA max_page_count = 1000000")


def test_a_full_disk_fails_only_the_changes_that_do_not_fit(library, writer):
    held, go_on = threading.Event(), threading.Event()

    def hold(_: Connection) -> None:
        held.set()
        assert go_on.wait(10)

    begun = writer.submit(hold)
    assert held.wait(10)
    changes = [fill if number % 3 == 1 else put for number in range(9)]
    waiting = [writer.submit(partial(change, name=f"n{number}")) for number, change in enumerate(changes)]
    go_on.set()
    begun.result(10)
    for number, future in enumerate(waiting):
        if number % 3 == 1:
            with pytest.raises(StoreFullError):
                future.result(10)
        else:
            assert library.get(future.result(10)).name == f"n{number}"
    assert names(library) == [f"n{number}" for number in range(9) if number % 3 != 1]
    writer.submit(partial(put, name="after")).result(10)
    assert names(library)[-1] == "after"
