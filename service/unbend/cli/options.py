"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar, get_args

import click
from click.core import ParameterSource

from unbend.cli.terminal import set_verbosity
from unbend.mesh.policy import Components, MeshPolicy, Seams
from unbend.names import DEFAULT_LIBRARY

F = TypeVar("F", bound=Callable[..., Any])

AUTO = "auto"
METHODS = ("least_squares", "classical", "fast")
UPDATES = ("spherical", "planar")
SCALINGS = ("area", "box")
FIRST_SAMPLES = ("end", "random")
WEIGHTINGS = ("equal", "inverse", "inverse_squared", "area")
CRITERIA = ("error", "stress")
# Names of the registries of measures and classifiers, which import numpy; a test compares them.
VECTOR_MEASURES = ("spectrum", "combined", "moments", "distribution", "dimension", "surface_moments")
PAIR_MEASURES = ("rigid", "hausdorff", "max_hausdorff", "reeb")
PART_MEASURES = ("partial", "partial_any_scale")
CLASSIFIERS = ("nearest", "vote", "mean", "discriminants")

Values = dict[str, Any]
"""The given options of a group, by field, as clients send and `from_dict` accepts them."""

folder_argument = click.argument("folder", metavar="DIR", type=click.Path(exists=True, file_okay=False, path_type=Path))
mesh_path = click.Path(exists=True, dir_okay=False, path_type=Path)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document on standard output.")
label_from_option = click.option(
    "--label-from", type=click.Choice(["folder"]), help="Take the name of each file's folder as its class."
)

_RANK: Final = (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT)
"""Sources of --library and --url; the first in this list wins."""


def _one_place(context: click.Context, option: click.Parameter, value: str | None) -> str | None:
    """Keep only one of --library and --url: an option overrides the environment, which overrides the default."""
    other = "url" if option.name == "library" else "library"
    if value is None or context.params.get(other) is None:
        return value
    mine, others = (_rank(context, str(name)) for name in (option.name, other))
    if mine == others:
        names = "--library and --url" if mine == 0 else "the variables UNBEND_LIBRARY and UNBEND_URL"
        hint = "" if mine == 0 else ": choose one by --library or --url"
        raise click.UsageError(f"{names} exclude each other{hint}")
    if mine > others:
        return None
    context.params[other] = None
    return value


def _rank(context: click.Context, name: str) -> int:
    source = context.get_parameter_source(name)
    return _RANK.index(source) if source in _RANK else len(_RANK)


library_option = click.option(
    "--library",
    metavar="URL",
    envvar="UNBEND_LIBRARY",
    show_envvar=True,
    default=DEFAULT_LIBRARY,
    show_default=True,
    callback=_one_place,
    help="Library: an SQLite file, or a database URL.",
)
url_option = click.option(
    "--url",
    metavar="HTTP",
    envvar="UNBEND_URL",
    show_envvar=True,
    callback=_one_place,
    help="Address of a running service, instead of a library. UNBEND_API_KEY is its key.",
)


_OBJECTS: Final = "unbend.objects"


def _note_objects(context: click.Context, _option: click.Parameter, value: str | None) -> None:
    context.meta[_OBJECTS] = value or None


objects_option = click.option(
    "--objects",
    metavar="URL",
    envvar="UNBEND_OBJECTS",
    show_envvar=True,
    expose_value=False,
    callback=_note_objects,
    help="Object store for the files of meshes, such as s3://bucket/prefix; the library by default.",
)


def chosen_objects() -> str | None:
    """Return the object store that --objects of the present command names; None for none."""
    context = click.get_current_context(silent=True)
    objects: str | None = context.meta.get(_OBJECTS) if context else None
    return objects


def place_options(command: F) -> F:
    """Add --library, --objects and --url. The command receives --library or --url, and None for the other."""
    return library_option(objects_option(url_option(command)))


def measure_option(
    names: Sequence[str], name: str = "measure", *, multiple: bool = False, description: str = ""
) -> Callable[[F], F]:
    """Return the option --measure with these choices; by default one of them, the first."""
    if multiple:
        return click.option("--measure", name, type=click.Choice(names), multiple=True, help=description)
    return click.option(
        "--measure",
        name,
        type=click.Choice(names),
        default=names[0],
        show_default=True,
        help=description or "Measure that compares the signatures.",
    )


classifier_option = click.option(
    "--classifier",
    type=click.Choice(CLASSIFIERS),
    default=CLASSIFIERS[0],
    show_default=True,
    help="The rule that turns distances from shapes into distances from classes.",
)


def _choose(context: click.Context, option: click.Parameter, value: bool) -> None:
    if value:
        set_verbosity(context, "verbose" if option.name == "verbose" else "quiet")


verbosity_options: Final = [
    click.Option(
        ["-v", "--verbose"],
        is_flag=True,
        expose_value=False,
        callback=_choose,
        help="Say what is being done and how long it takes; show where an unexpected error occurred.",
    ),
    click.Option(
        ["-q", "--quiet"],
        is_flag=True,
        expose_value=False,
        callback=_choose,
        help="Print only results and errors, no notes, warnings or progress.",
    ),
]
"""Options of the program and of each command."""


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
