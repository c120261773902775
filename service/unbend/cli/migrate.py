"""`unbend migrate` and `unbend migrate-library`."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

import click

from unbend.brief import counted
from unbend.cli.options import json_option, library_option
from unbend.cli.places import check_library
from unbend.cli.terminal import confirm, is_quiet, progress_bar, warn
from unbend.names import printable

if TYPE_CHECKING:
    from collections.abc import Callable

    from unbend.library.moving.move import Progress

_SILENT_SECONDS: Final = 10.0
"""Longest time without a line of progress, where there is no terminal."""


@click.command()
@library_option
@click.option("--check", "check_only", is_flag=True, help="Fail if a migration is needed; change nothing.")
@json_option
def migrate(library: str, check_only: bool, as_json: bool) -> None:
    """Migrate a library to the schema of this version.

    A server does this when it starts, unless UNBEND_MIGRATE is false. So this command is for clusters: it runs once,
    before the servers and workers of a new version start. An empty database in PostgreSQL becomes an empty library.
    """
    from unbend.library.storage import migration  # noqa: PLC0415
    from unbend.library.storage.database import shown_url  # noqa: PLC0415

    check_library(library)
    done = migration.must_be_migrated(library) if check_only else migration.migrate(library)
    name = printable(shown_url(library))
    document = {"library": name, "before": done.before, "after": done.after, "migrated": done.is_needed}
    confirm(document, f"{name}: {_said(done.before, done.after, done.is_needed)}", as_json=as_json)


@click.command("migrate-library")
@click.argument("source", metavar="SOURCE")
@click.argument("target", metavar="TARGET")
@json_option
def migrate_library(source: str, target: str, as_json: bool) -> None:
    """Copy the library SOURCE to TARGET, such as from SQLite to PostgreSQL, or back.

    Both are an SQLite file or a database URL. TARGET is a new file or an empty database. It then has everything that
    SOURCE has: ids, pages, jobs, keys and answers are the same. Jobs that ran are queued. SOURCE stays unchanged.

    No server and no worker may use SOURCE meanwhile. A hash of each row is read back from TARGET and compared. If the
    command is interrupted, run it again: it goes on where it was. Until it is complete, TARGET does not open as a
    library.
    """
    from unbend.library.moving.move import move_library  # noqa: PLC0415
    from unbend.library.storage.database import shown_url  # noqa: PLC0415

    began = time.perf_counter()
    with _progress() as report:
        done = move_library(source, target, progress=report)
    seconds, rows, name = time.perf_counter() - began, sum(done.rows.values()), printable(shown_url(target))
    document = {
        "source": printable(shown_url(source)),
        "target": name,
        "rows": done.rows,
        "copied": done.copied,
        "requeued": done.requeued,
        "seconds": seconds,
    }
    there = f", {rows - done.copied} of them were there already" if done.copied < rows else ""
    found = f"{counted(done.rows['shapes'], 'shape')}, {counted(rows, 'row')} compared"
    confirm(document, f"{name}: {found} in {seconds:.1f} s{there}", as_json=as_json)


def _said(before: str | None, after: str, is_needed: bool) -> str:
    if not is_needed:
        return f"schema {after}, nothing to do"
    if before == after:
        return f"schema {after}, the queue was migrated"
    return f"schema {before} -> {after}" if before else f"schema {after}, new"


@contextmanager
def _progress() -> Iterator[Callable[[Progress], None]]:
    """Yield a callback that shows a bar on a terminal, and otherwise prints a line for each table."""
    if is_quiet() or not sys.stderr.isatty():
        yield _Lines().report
        return
    with progress_bar() as bar:
        task = bar.add_task("", total=None)

        def report(progress: Progress) -> None:
            bar.update(task, description=progress.table, completed=progress.rows, total=progress.of)

        yield report


class _Lines:
    """Prints a line when a table is complete, and after some seconds without one."""

    def __init__(self) -> None:
        self._printed = time.monotonic()

    def report(self, progress: Progress) -> None:
        now = time.monotonic()
        if progress.rows == progress.of > 0:
            warn(f"{progress.table}: {counted(progress.of, 'row')}")
        elif now - self._printed > _SILENT_SECONDS:
            warn(f"{progress.table}: {progress.rows} of {counted(progress.of, 'row')}")
        else:
            return
        self._printed = now
