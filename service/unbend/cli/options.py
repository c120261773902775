"""Options that several commands share, and progress on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from unbend.signature.parameters import Parameters

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

METHODS = ("least_squares", "classical", "fast")

folder_argument = click.argument("folder", metavar="DIR", type=click.Path(exists=True, file_okay=False, path_type=Path))
mesh_path = click.Path(exists=True, dir_okay=False, path_type=Path)
library_option = click.option(
    "--library", metavar="URL", envvar="UNBEND_LIBRARY", help="Library: an SQLite file, or a database URL."
)
url_option = click.option("--url", metavar="HTTP", help="Address of a running service, instead of a library.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


def parameter_options(command: F) -> F:
    """Add --samples, --dimensions and --method."""
    for option in (
        click.option("--method", type=click.Choice(METHODS), default="least_squares", show_default=True),
        click.option("--dimensions", type=int, default=3, show_default=True, help="Of the signature's space."),
        click.option("--samples", type=int, default=300, show_default=True, help="Farthest point samples."),
    ):
        command = option(command)
    return command


def make_parameters(samples: int, dimensions: int, method: str) -> Parameters:
    """Return the parameters that the options say."""
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    return Parameters.from_dict({"samples": samples, "dimensions": dimensions, "method": method})


@contextmanager
def progress(items: Iterable[T], label: str, length: int) -> Iterator[Iterable[T]]:
    """Show a bar on standard error while items pass; nothing where that is no terminal."""
    with click.progressbar(
        items, length=length, label=label, file=sys.stderr, show_pos=True, hidden=not sys.stderr.isatty()
    ) as bar:
        yield bar


def warn(message: str) -> None:
    """Print a line on standard error."""
    click.echo(message, err=True)
