"""An account of many files: what happened to each, as lines on standard error, as counts, and as a table."""

from __future__ import annotations

import csv
import json
import sys
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal, Protocol, Self, TypeVar, get_args

import click

from unbend.brief import noted
from unbend.cli.folders.files import NO_FILE, LabelledFile, LeftOut, relative_name
from unbend.cli.group import EXIT_INTERRUPTED
from unbend.cli.terminal import confirm, print_error, progress, warn, warn_of
from unbend.errors import ParameterError
from unbend.names import printable

FileT_co = TypeVar("FileT_co", bound=LabelledFile, covariant=True)


class MeshSet(Protocol[FileT_co]):
    """Meshes, and the files beside them that are left out. Every iteration yields the same."""

    @property
    def emptiness(self) -> str:
        """The error if there is no mesh; empty if that is no error."""

    def __iter__(self) -> Iterator[FileT_co | LeftOut]: ...


Outcome = Literal["new", "changed", "unchanged", "merged", "failed", "left out"]
"""The end of a file.

`changed` and `unchanged` files were known before. A `merged` file has the same content as an earlier one.
"""

report_option = click.option(
    "--report",
    metavar="FILE",
    type=click.Path(dir_okay=False, writable=True, path_type=Path),
    help="Write a row for each file: CSV, or JSON lines if FILE ends in .jsonl.",
)


@dataclass(frozen=True)
class Ended:
    """A file, and what happened to it."""

    path: Path
    outcome: Outcome
    reason: str = ""
    """Why the file failed, is left out or keeps its class, or the file that it is merged with."""
    result: str = ""
    """The id of the shape, or the file that was written."""
    taken: Sequence[str] = ()
    """The fields of "name", "label" and "metadata" that a known shape took."""
    ignored: Sequence[str] = ()
    """The fields that a known shape did not take."""
    warnings: Sequence[str] = ()

    @property
    def words(self) -> str:
        """The outcome in words, equal for files that are counted together."""
        fields = [f"{' and '.join(self.taken)} taken"] if self.taken else []
        fields += [f"{' and '.join(self.ignored)} ignored"] if self.ignored else []
        match self.outcome:
            case "left out":
                details = [self.reason]
            case "changed" | "unchanged":
                details = ["known already", *fields, self.reason]
            case "merged":
                details = ["the same content as another file", *fields]
            case _:
                details = []
        return ": ".join(part for part in (self.outcome, ", ".join(filter(None, details))) if part)


class Account:
    """Prints, counts and records files as they end. It keeps only counts in memory.

    Parameters
    ----------
    folder : Path
        The folder to which the paths of the table are relative.
    report : Path, optional
        The file of the table.
    """

    def __init__(self, folder: Path, report: Path | None) -> None:
        self._folder = folder
        self._rows = _Rows(report) if report else None
        self._counts: Counter[tuple[Outcome, str]] = Counter()
        self._examples: dict[str, str] = {}
        self._warned = 0
        self._rows_without_file = 0
        self.meshes = 0
        """Number of meshes in the folder, once they are counted."""
        self.has_faults = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._rows:
            self._rows.close()

    def add(self, ended: Ended) -> None:
        """Print what is wrong with a file, count it, and write its row."""
        self._counts[ended.outcome, ended.words] += 1
        self._warned += bool(ended.warnings)
        if self._rows:
            self._rows.write({"path": relative_name(ended.path, self._folder), **_as_dict(ended)})
        if ended.outcome == "failed":
            self.has_faults = True
            print_error(f"{ended.path}: {ended.reason}")
        elif ended.outcome == "merged":
            fields = f"; its {' and '.join(ended.ignored)} is ignored" if ended.ignored else ""
            warn(f"{ended.path}: has the same bytes as {ended.reason}, so both are one shape{fields}")
        elif ended.reason:
            self._examples.setdefault(ended.words, relative_name(ended.path, self._folder))
        warn_of(ended.path, ended.warnings)

    def leave_out(self, item: LeftOut) -> None:
        """Count a file that is left out, write its row, and print what is wrong if the user asked for it."""
        ended = Ended(item.path, "left out", item.reason)
        self._rows_without_file += item.reason == NO_FILE
        self.add(ended)
        if item.fault:
            self.has_faults = True
            print_error(item.fault)

    def count(self, *outcomes: Outcome) -> int:
        """Return the number of files with one of these outcomes, or of all files."""
        return sum(count for (outcome, _), count in self._counts.items() if not outcomes or outcome in outcomes)

    def print_counts(self) -> None:
        """Print the number of files, and the numbers that add up to it."""
        not_reached = max(0, self.meshes - self.attempted)
        found = self.count() + not_reached - self._rows_without_file
        rows = noted(self._rows_without_file, "row without a file", "rows without a file")
        counts = [(found, f"{'file' if found == 1 else 'files'} found{rows and f', and {rows}'}")]
        for outcome in get_args(Outcome):
            same = sorted((words, count) for (of, words), count in self._counts.items() if of == outcome)
            counts += [
                (count, f"{words}, such as {self._examples[words]}" if words in self._examples else words)
                for words, count in same
            ]
        counts += [(not_reached, "not reached")] if not_reached else []
        for count, words in counts:
            warn(f"{count:>9,} {words}")
        if self._warned:
            warn(f"{self._warned:,} of the files {'has' if self._warned == 1 else 'have'} warnings")

    def print_result(self, done: str, *, as_json: bool) -> None:
        """Print the result as one line, or the number of files with each outcome as JSON."""
        document = {"attempted": self.attempted} | {
            outcome.replace(" ", "_"): self.count(outcome) for outcome in get_args(Outcome)
        }
        confirm(document, self.result(done), as_json=as_json)

    def result(self, done: str) -> str:
        """Return one line about the files that are not left out, such as "3 of 4 shapes imported: 2 new, 1 merged"."""
        successes: tuple[Outcome, ...] = ("new", "changed", "unchanged", "merged")
        parts = [f"{self.count(of)} {of}" for of in successes if of == "new" or self.count(of)]
        return f"{self.count(*successes)} of {self.attempted} {done}: {', '.join(parts)}"

    @property
    def attempted(self) -> int:
        """The number of files that ended and were not left out."""
        return self.count() - self.count("left out")


@contextmanager
def accounting(folder: Path, report: Path | None, *, kept: str) -> Iterator[Account]:
    """Yield an account; print its counts at the end, also after an error or SIGINT, which ends the program.

    `kept` says after SIGINT what remains of the work.
    """
    with Account(folder, report) as account:
        try:
            yield account
        except KeyboardInterrupt:
            account.print_counts()
            print_error(f"unbend: interrupted; {kept}")
            sys.exit(EXIT_INTERRUPTED)
        except Exception:
            if account.attempted:
                account.print_counts()
            raise
        account.print_counts()


def meshes_of(source: MeshSet[FileT_co], account: Account) -> Iterator[FileT_co]:
    """Account for the files that are left out, and return an iterator over the others; ParameterError if there is none.

    `account.meshes` is then their number.
    """
    for item in source:
        if isinstance(item, LeftOut):
            account.leave_out(item)
        else:
            account.meshes += 1
    if not account.meshes and (emptiness := source.emptiness):
        raise ParameterError(emptiness)
    return (item for item in source if not isinstance(item, LeftOut))


def account_for(ended: Generator[Ended], account: Account, label: str) -> None:
    """Add files to an account as they end, and show the progress.

    The generator is closed at once if SIGINT comes, so that its processes end.
    """
    with closing(ended), progress(ended, label, account.meshes) as bar:
        for file in bar:
            account.add(file)


class _Rows:
    """A file of rows, each written at once."""

    def __init__(self, path: Path) -> None:
        self._file: IO[str] = path.open("w", newline="", encoding="utf-8", buffering=1)  # by lines
        self._is_json = path.suffix.lower() == ".jsonl"
        self._writer = csv.writer(self._file)
        if not self._is_json:
            self._writer.writerow(["path", *_as_dict(Ended(path, "new"))])

    def write(self, row: dict[str, Any]) -> None:
        if self._is_json:
            self._file.write(json.dumps(row) + "\n")
        else:
            self._writer.writerow([" | ".join(value) if isinstance(value, list) else value for value in row.values()])

    def close(self) -> None:
        self._file.close()


def _as_dict(ended: Ended) -> dict[str, Any]:
    """Return the values of a row after its path."""
    return {
        "outcome": ended.outcome,
        "reason": printable(ended.reason),
        "result": printable(ended.result),
        "taken": list(ended.taken),
        "ignored": list(ended.ignored),
        "warnings": [printable(warning) for warning in ended.warnings],
    }
