"""SQLite: the settings of connections, and the beginning of transactions."""

from __future__ import annotations

from typing import Any, Final

from sqlalchemy import Connection, Engine, event

_BUSY_SECONDS: Final = 30


def prepare(engine: Engine) -> Engine:
    """Give the engine of a library's file or memory this program's settings, and return it."""
    with_own_transactions(engine)
    event.listen(engine, "connect", _set_up)
    return engine


def with_own_transactions(engine: Engine) -> Engine:
    """Make an engine begin its transactions as this program needs them, and return it."""
    event.listen(engine, "connect", _disable_driver_transactions)
    event.listen(engine, "begin", _begin)
    return engine


def _disable_driver_transactions(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # `_begin` begins transactions, not the driver


def _set_up(connection: Any, _record: object) -> None:
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {_BUSY_SECONDS * 1000}")
    cursor.execute("PRAGMA journal_mode = WAL")
    cursor.execute("PRAGMA synchronous = FULL")  # acknowledged changes survive a power failure
    cursor.execute("PRAGMA secure_delete = ON")  # SQLite overwrites deleted content
    cursor.close()


def _begin(connection: Connection) -> None:
    options = connection.get_execution_options()
    # Use the driver's connection: SQLAlchemy's path to a cursor costs more than a small transaction.
    driver: Any = connection.connection.dbapi_connection
    # A migration replaces tables: with foreign keys, dropping the old table would delete every row that refers to it.
    driver.execute(f"PRAGMA foreign_keys = {'OFF' if options.get('unbend_migrating') else 'ON'}")
    # A writer locks at once: SQLite can refuse a transaction that reads first and writes later.
    driver.execute("BEGIN" if options.get("unbend_reading") else "BEGIN IMMEDIATE")
