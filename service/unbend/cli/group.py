"""Groups of commands that print errors as sentences, and whose commands have --verbose and --quiet."""

from __future__ import annotations

import errno
import sys
from typing import Any, Final

import click

from unbend.cli.advice import advice_for
from unbend.cli.options import verbosity_options
from unbend.cli.terminal import is_verbose, print_error
from unbend.errors import StoreInUseError, UnbendError

EXIT_FAILED: Final = 1
EXIT_IN_USE: Final = 3  # so that a supervisor can distinguish a second server from a failed one
EXIT_SOME_FAILED: Final = 4  # the command did its work for the others
EXIT_UNEXPECTED: Final = 70  # EX_SOFTWARE of sysexits.h
EXIT_INTERRUPTED: Final = 130  # as shells report a program that SIGINT ended


class CommandGroup(click.Group):
    """A group of commands that prints errors as sentences; only an unexpected error has a traceback, with --verbose."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.params.extend(verbosity_options)

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """Add a command, which gets --verbose and --quiet."""
        super().add_command(cmd, name)
        if not isinstance(cmd, CommandGroup):
            cmd.params.extend(verbosity_options)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command, and print its error."""
        try:
            return super().invoke(ctx)
        except (click.exceptions.Exit, click.Abort, click.ClickException):
            raise
        except Exception as error:
            if isinstance(error, OSError) and error.errno == errno.EPIPE:
                raise  # the reader of a pipe has read enough; click ends the program
            sys.exit(_told(error, self.get_command(ctx, ctx.invoked_subcommand or ""), ctx))


def _told(error: Exception, command: click.Command | None, context: click.Context) -> int:
    """Print an error as a sentence, and advice; return the exit status."""
    if isinstance(error, UnbendError):
        print_error(f"unbend: {error}")
        if advice := advice_for(error, command, context):
            print_error(f"        {advice}")
        return EXIT_IN_USE if isinstance(error, StoreInUseError) else EXIT_FAILED
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        print_error(f"unbend: {place}{error.strerror or error}")
        return EXIT_FAILED
    if is_verbose():
        import traceback  # noqa: PLC0415

        print_error("".join(traceback.format_exception(error)).rstrip())
    print_error(f"unbend: unexpected error: {type(error).__name__}: {error}")
    if not is_verbose():
        print_error("        This is a bug in unbend. Run the command again with --verbose, and report what it prints.")
    return EXIT_UNEXPECTED
