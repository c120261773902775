"""The command group, which prints errors as sentences."""

from __future__ import annotations

import os
import sys
from typing import Any

import click

from unbend import __version__
from unbend.cli.backup import backup, restore
from unbend.cli.compare import compare
from unbend.cli.complete import complete
from unbend.cli.demo import demo
from unbend.cli.evaluate import evaluate
from unbend.cli.export import export
from unbend.cli.flatten import flatten
from unbend.cli.importing import import_folder
from unbend.cli.keys import keys
from unbend.cli.match import match
from unbend.cli.openapi import openapi
from unbend.cli.options import warn
from unbend.cli.query import query
from unbend.cli.serve import serve
from unbend.cli.show import show
from unbend.cli.signature import signature
from unbend.cli.symmetry import symmetry
from unbend.cli.transfer import transfer
from unbend.errors import StoreInUseError, UnbendError

EXIT_FAILED = 1
EXIT_IN_USE = 3  # so that a supervisor can distinguish a second server from a failed one

# Set before NumPy is loaded. unbend uses all cores with its own threads and processes. OpenBLAS' threads would slow
# them down, because they spin while they wait, and unbend's matrices are too small to gain from them.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


class ErrorPrintingGroup(click.Group):
    """A group of commands that prints errors as sentences instead of tracebacks."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command, and print its error."""
        try:
            return super().invoke(ctx)
        except UnbendError as error:
            warn(f"unbend: {error}")
            if error.advice:
                warn(f"        {error.advice}")
            sys.exit(EXIT_IN_USE if isinstance(error, StoreInUseError) else EXIT_FAILED)
        except OSError as error:
            warn(f"unbend: {error.filename or ''}: {error.strerror or error}")
            sys.exit(EXIT_FAILED)


@click.group(cls=ErrorPrintingGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="unbend")
def main() -> None:
    """Recognise shapes however they bend."""


for command in (
    serve, signature, flatten, show, compare, match, transfer, symmetry, import_folder, export, query, evaluate,
    complete, backup, restore, keys, openapi, demo,
):  # fmt: skip
    main.add_command(command)
