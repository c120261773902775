"""Options that several commands share, and progress on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, get_args

import click
from click.core import ParameterSource

from unbend.mesh.policy import Components, MeshPolicy, Seams
from unbend.names import printable

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

AUTO = "auto"
METHODS = ("least_squares", "classical", "fast")
UPDATES = ("spherical", "planar")
SCALINGS = ("area", "box")
FIRST_SAMPLES = ("end", "random")
WEIGHTINGS = ("equal", "inverse", "inverse_squared", "area")
CRITERIA = ("error", "stress")

Values = dict[str, Any]
"""The given options of a group, by field, as clients send and `from_dict` accepts them."""

folder_argument = click.argument("folder", metavar="DIR", type=click.Path(exists=True, file_okay=False, path_type=Path))
mesh_path = click.Path(exists=True, dir_okay=False, path_type=Path)
library_option = click.option(
    "--library", metavar="URL", envvar="UNBEND_LIBRARY", help="Library: an SQLite file, or a database URL."
)
url_option = click.option("--url", metavar="HTTP", help="Address of a running service, instead of a library.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


def output_option(description: str, *, required: bool = False) -> Callable[[F], F]:
    """Return the option -o for the file that a command writes."""
    path = click.Path(dir_okay=False, path_type=Path)
    return click.option("-o", "--output", required=required, type=path, help=description)


def _group(name: str, options: dict[str, dict[str, Any]]) -> Callable[[F], F]:
    """Return a decorator that adds `options`. The command receives the given ones in one mapping named `name`."""

    def put(context: click.Context, option: click.Parameter, value: object) -> None:
        given = context.params.setdefault(name, {})
        if option.name and context.get_parameter_source(option.name) is not ParameterSource.DEFAULT:
            given[option.name] = value

    def add(command: F) -> F:
        for flag, settings in reversed(options.items()):
            command = click.option(flag, expose_value=False, callback=put, show_default=True, **settings)(command)
        return command

    return add


def _count(value: str) -> int | str:
    return AUTO if value == AUTO else int(value)


parameter_options = _group(
    "parameters",
    {
        "--samples": {
            "type": _count,
            "metavar": "N|auto",
            "default": 300,
            "help": 'Farthest point samples; "auto" doubles them until the spectrum is stable.',
        },
        "--dimensions": {
            "type": _count,
            "metavar": "N|auto",
            "default": 3,
            "help": 'Dimensions of the signature; "auto" chooses the number.',
        },
        "--method": {"type": click.Choice(METHODS), "default": "least_squares", "help": "How samples are embedded."},
        "--update": {"type": click.Choice(UPDATES), "default": "spherical", "help": "How marching crosses a triangle."},
        "--scaling": {
            "type": click.Choice(SCALINGS),
            "default": "area",
            "help": "Quantity that is scaled to 1.",
        },
        "--first-sample": {"type": click.Choice(FIRST_SAMPLES), "default": "end", "help": "Where sampling begins."},
        "--starts": {
            "metavar": "N",
            "type": int,
            "default": 0,
            "help": "Further random starts of least squares.",
        },
        "--seed": {"metavar": "N", "type": int, "default": 0, "help": "Seed of all random choices."},
        "--weights": {"type": click.Choice(WEIGHTINGS), "default": "equal", "help": "Weights of pairs in the stress."},
        "--criterion": {
            "type": click.Choice(CRITERIA),
            "default": "error",
            "help": 'Quantity that --threshold limits if --dimensions is "auto": eq. 6, or the stress.',
        },
        "--threshold": {
            "metavar": "X",
            "type": float,
            "default": 0.05,
            "help": 'Limit of --criterion for --dimensions "auto".',
        },
        "--tolerance": {
            "metavar": "X",
            "type": float,
            "default": 0.02,
            "help": 'For --samples "auto": the share by which the spectrum may still change.',
        },
    },
)
policy_options = _group(
    "policy",
    {
        "--components": {
            "type": click.Choice(get_args(Components)),
            "default": MeshPolicy().components,
            "help": "For a mesh of several parts: keep the largest, link all, or refuse the mesh.",
        },
        "--max-vertices": {"metavar": "N", "type": int, "help": "Simplify meshes of more than N vertices."},
        "--smooth": {
            "metavar": "N",
            "type": int,
            "default": 0,
            "help": "Rounds of smoothing, for noisy scans.",
        },
        "--seams": {
            "type": click.Choice(get_args(Seams)),
            "default": MeshPolicy().seams,
            "help": "Join edges whose ends coincide, or keep the surface cut there.",
        },
    },
)


@contextmanager
def progress(items: Iterable[T], label: str, length: int) -> Iterator[Iterable[T]]:
    """Show a progress bar on standard error if it is a terminal."""
    with click.progressbar(
        items, length=length, label=label, file=sys.stderr, show_pos=True, hidden=not sys.stderr.isatty()
    ) as bar:
        yield bar


def warn(message: str) -> None:
    """Print a line on standard error."""
    click.echo(printable(message), err=True)


def warn_of(name: object, warnings: Iterable[str]) -> None:
    """Print the `warnings` about a file on standard error."""
    for sentence in warnings:
        warn(f"{name}: warning: {sentence}")
