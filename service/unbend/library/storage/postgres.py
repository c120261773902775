"""PostgreSQL: the settings of connections, locks, and the errors after which a transaction may succeed again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from sqlalchemy import URL, Connection, Engine, Update, create_engine, func, text
from sqlalchemy.exc import DBAPIError, OperationalError, TimeoutError  # noqa: A004

from unbend.errors import StoreVersionError
from unbend.extras import extra

OLDEST: Final = 16
"""The oldest version of PostgreSQL whose behaviour the tests have seen, or its successors promise."""

NAME: Final = "unbend"
"""The name of the sessions of servers, workers and commands."""

MOVING: Final = "unbend moving"
"""The name of the sessions that move a library between databases."""

_OPTIONS: Final = {
    "statement_timeout": "60s",
    "lock_timeout": "30s",
    "idle_in_transaction_session_timeout": "60s",  # so that a frozen process does not hold its locks
    "client_connection_check_interval": "10s",  # so that the server ends the statements of a process that died
}
_CONNECTING: Final = {
    "application_name": NAME,
    "connect_timeout": 5,
    # A network that drops packets is noticed after half a minute, and not after hours.
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 4,
    "tcp_user_timeout": 30_000,
    "options": " ".join(f"-c {name}={value}" for name, value in _OPTIONS.items()),
}
_TIME_LIMITS: Final = ("statement_timeout", "lock_timeout", "idle_in_transaction_session_timeout")
_CONNECTIONS: Final = 8
_MORE_CONNECTIONS: Final = 16
_WAIT_SECONDS: Final = 10

_TRANSIENT: Final = frozenset(
    {
        "40001",  # serialization_failure
        "40P01",  # deadlock_detected
        "55P03",  # lock_not_available
        "23503", "23505",  # a concurrent transaction added or removed the row that a check had not seen, or had seen
        "53300",  # too_many_connections
        "57P01", "57P02", "57P03", "57P05",  # the server stops, crashed or starts, or ended an idle session
    }
)  # fmt: skip
"""States of errors after which the same transaction may succeed."""

_CONNECTION_LOST: Final = "08"
"""The class of the states of lost connections."""

_DISK_FULL: Final = "53100"


def open_postgres(address: URL) -> Engine:
    """Return an engine; ExtraMissingError if the driver is not installed."""
    with extra("cluster"):
        import psycopg  # noqa: F401, PLC0415
    return create_engine(
        address.set(drivername="postgresql+psycopg"),
        connect_args=_CONNECTING,
        pool_size=_CONNECTIONS,
        max_overflow=_MORE_CONNECTIONS,
        # No test of a connection before its use: transactions run again if a restart of the server has ended it.
        pool_timeout=_WAIT_SECONDS,
    )


def connection_arguments(engine: Engine) -> Mapping[str, Any]:
    """Return the arguments with which psycopg connects as an engine does."""
    _, arguments = engine.dialect.create_connect_args(engine.url)
    return {**arguments, **_CONNECTING}


def one_state(engine: Engine) -> Engine:
    """Return an engine whose transactions read one unchanging state of the database, and cannot write."""
    return engine.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)


def one_statement(engine: Engine) -> Engine:
    """Return an engine that commits each statement by itself."""
    return engine.execution_options(isolation_level="AUTOCOMMIT")


def begin_migration(connection: Connection) -> None:
    """Wait until no other process migrates the database, without a limit on time.

    Raises
    ------
    StoreVersionError
        If the server is too old.
    """
    version: int = connection.execute(_VERSION).scalar_one()
    if version < OLDEST:
        raise StoreVersionError(f"the library is in PostgreSQL {version}").with_advice(
            f"Use PostgreSQL {OLDEST} or newer."
        )
    for name in _TIME_LIMITS:
        connection.execute(text(f"SET LOCAL {name} = 0"))
    lock(connection, "migration")


def begin_move(connection: Connection) -> None:
    """Give a connection no limits on time, and the name that `other_sessions` counts apart; commit."""
    for name in _TIME_LIMITS:
        connection.execute(text(f"SET {name} = 0"))
    connection.execute(text(f"SET application_name = '{MOVING}'"))
    connection.commit()


def other_sessions(connection: Connection, name: str) -> int:
    """Return the number of other sessions of this program on the database that have a name."""
    found: int = connection.execute(_SESSIONS, {"name": name}).scalar_one()
    connection.commit()  # PostgreSQL counts once in each transaction
    return found


def lock(connection: Connection, name: str) -> None:
    """Lock a name until the transaction ends, so that another transaction with this lock sees what this one wrote.

    Other databases need no lock, because they have one writer at a time.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(_LOCK, {"name": f"unbend {name}"})


def without_wait(change: Update) -> Update:
    """Return a change whose commit does not wait for the disk: a crash of the database may undo it."""
    return change.where(func.set_config("synchronous_commit", "off", True) == "off")


_VERSION: Final = text("SELECT current_setting('server_version_num')::integer / 10000")
_LOCK: Final = text("SELECT pg_advisory_xact_lock(hashtextextended(:name, 0))")
_SESSIONS: Final = text(
    "SELECT count(*) FROM pg_stat_activity"
    " WHERE datname = current_database() AND application_name = :name AND pid <> pg_backend_pid()"
)


def is_transient(error: BaseException) -> bool:
    """Return whether an error of the database may be over when the transaction runs again."""
    if isinstance(error, TimeoutError):  # all connections of the pool are in use
        return True
    if not isinstance(error, DBAPIError) or not hasattr(error.orig, "sqlstate"):  # another database
        return False
    state = _state(error)
    is_silent = isinstance(error, OperationalError) and not state  # the server refused or closed a connection
    return is_silent or error.connection_invalidated or state[:2] == _CONNECTION_LOST or state in _TRANSIENT


def is_disk_full(error: BaseException) -> bool:
    """Return whether the disk of the database is full."""
    return isinstance(error, DBAPIError) and _state(error) == _DISK_FULL


def _state(error: DBAPIError) -> str:
    original: Any = error.orig
    return getattr(original, "sqlstate", None) or ""
