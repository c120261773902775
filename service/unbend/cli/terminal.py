"""The terminal: results on standard output; notes, warnings, errors and progress on standard error."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

import click

from unbend.names import printable

if TYPE_CHECKING:
    from pathlib import Path

    from unbend.progress import Progress, ProgressCallback

T = TypeVar("T")

Verbosity = Literal["quiet", "normal", "verbose"]

_VERBOSITY: Final = "unbend.verbosity"
_COMPILING: Final = "Compiling the kernels, once on this machine; this takes about a minute"
_COMPILING_MORE: Final = "Compiling kernels of this command, once on this machine; this takes some seconds"


def set_verbosity(context: click.Context, verbosity: Verbosity) -> None:
    """Choose how much the command of `context` prints on standard error; `verbose` also prints the log."""
    chosen = context.meta.get(_VERBOSITY, verbosity)
    if chosen != verbosity:
        raise click.UsageError("--verbose and --quiet exclude each other")
    if verbosity == "verbose" and _VERBOSITY not in context.meta:
        _print_log(context)
    context.meta[_VERBOSITY] = verbosity


def is_quiet() -> bool:
    """Return whether the command prints only errors and what it was asked for."""
    return _verbosity() == "quiet"


def is_verbose() -> bool:
    """Return whether the command says what it does."""
    return _verbosity() == "verbose"


def _verbosity() -> Verbosity:
    context = click.get_current_context(silent=True)
    return context.meta.get(_VERBOSITY, "normal") if context else "normal"


def _print_log(context: click.Context) -> None:
    """Print the log of this package, and the requests to a service, on standard error until the command ends."""
    import logging  # noqa: PLC0415

    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("unbend: %(message)s"))
    for name in ("unbend", "httpx"):
        logger = logging.getLogger(name)
        level = logger.level
        logger.setLevel(logging.INFO)
        logger.addHandler(handler)
        context.find_root().call_on_close(lambda logger=logger, level=level: _restore(logger, level, handler))


def _restore(logger: Any, level: int, handler: Any) -> None:
    logger.removeHandler(handler)
    logger.setLevel(level)


# Results


def print_result(document: Mapping[str, Any], text: str | Callable[[], str], *, as_json: bool) -> None:
    """Print what a command was asked for: `document` as one line of JSON, or `text`."""
    if as_json:
        click.echo(json.dumps(document))
    else:
        click.echo(text if isinstance(text, str) else text())


def confirm(document: Mapping[str, Any], text: str, *, as_json: bool) -> None:
    """Print what a command did, as `print_result` does; without --json nothing with --quiet."""
    if as_json or not is_quiet():
        print_result(document, text, as_json=as_json)


def confirm_file(output: Path, text: str, figures: Mapping[str, Any], *, as_json: bool) -> None:
    """Print what a command wrote to `output`: `text` on standard error, or its figures as JSON on standard output."""
    if as_json:
        click.echo(json.dumps({"output": printable(str(output)), **figures}))
    else:
        warn(f"{output}: {text}")


# Messages on standard error


def warn(message: str) -> None:
    """Print a note or a warning on standard error, unless the command is quiet."""
    if not is_quiet():
        print_error(message)


def warn_of(name: object, warnings: Iterable[str]) -> None:
    """Print the `warnings` about a file on standard error, unless the command is quiet."""
    for sentence in warnings:
        warn(f"{name}: warning: {sentence}")


def print_error(message: str) -> None:
    """Print a line on standard error."""
    click.echo(printable(message), file=sys.stderr)  # not err=True, which would write past a bar of Rich


def say(message: str) -> None:
    """Print what is being done on standard error, with --verbose."""
    if is_verbose():
        print_error(f"unbend: {message}")


def prepare_kernels() -> None:
    """Compile the common kernels if this machine has none yet, and say so once, unless the command is quiet.

    Later, the command says once if it compiles others.
    """
    import logging  # noqa: PLC0415

    logging.getLogger("unbend.jit").setLevel(logging.ERROR)  # this command says it itself
    context = click.get_current_context()
    if _COMPILING in context.meta:
        return
    context.meta[_COMPILING] = True
    from unbend.geodesics.marching import march  # noqa: PLC0415
    from unbend.jit import is_compiled, on_compilation  # noqa: PLC0415

    if not is_compiled(march):
        warn(_COMPILING)
        from unbend.jobs.kernels import compile_common_kernels  # noqa: PLC0415

        compile_common_kernels()
    if not is_quiet():
        context.find_root().call_on_close(on_compilation(lambda: print_error(_COMPILING_MORE)))


# Progress


@contextmanager
def progress(items: Iterable[T], label: str, length: int) -> Iterator[Iterable[T]]:
    """Show a progress bar on standard error if it is a terminal, and the time with --verbose."""
    began = time.perf_counter()
    if is_quiet() or not sys.stderr.isatty():
        yield items
    else:
        with progress_bar() as bar:
            yield bar.track(items, total=length, description=label)
    say(f"{label}: {time.perf_counter() - began:.2f} s")


@contextmanager
def stages(name: str) -> Iterator[ProgressCallback]:
    """Yield a callback that shows the stages of one computation on a terminal, and their times with --verbose."""
    watch = _StageWatch(name)
    if is_quiet() or not sys.stderr.isatty():
        yield watch.report
    else:
        from rich.progress import BarColumn, TextColumn  # noqa: PLC0415

        with _bar(TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[stage]}")) as bar:
            task = bar.add_task(printable(name), total=1.0, stage="")

            def report(progress: Progress) -> None:
                bar.update(task, completed=progress.share, stage=progress.stage)
                watch.report(progress)

            yield report
            bar.update(task, visible=False)
    watch.end()


def progress_bar() -> Any:
    """Return a bar of Rich for counted items, which begins with the description of its task."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn  # noqa: PLC0415

    return _bar(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())


def _bar(*columns: Any) -> Any:
    """Return a bar on standard error. Standard output stays free for results."""
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import Progress as Bar  # noqa: PLC0415

    return Bar(*columns, console=Console(stderr=True), redirect_stdout=False, transient=True, refresh_per_second=4)


class _StageWatch:
    """Says with --verbose how long each stage took."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._stage: str | None = None
        self._began = time.perf_counter()

    def report(self, progress: Progress) -> None:
        if progress.stage != self._stage:
            self.end()
            self._stage = progress.stage

    def end(self) -> None:
        now = time.perf_counter()
        if self._stage is not None:
            say(f"{self._name}: {self._stage}: {now - self._began:.2f} s")
        self._began = now
