"""`unbend query`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from unbend.cli.options import (
    PAIR_MEASURES,
    PART_MEASURES,
    VECTOR_MEASURES,
    Values,
    classifier_option,
    json_option,
    measure_option,
    mesh_path,
    parameter_options,
    place_options,
    policy_options,
)
from unbend.cli.places import Place, open_place, rank_file
from unbend.cli.tables import table
from unbend.cli.terminal import print_result, warn

if TYPE_CHECKING:
    from unbend.results.rankings import PartRelation, Ranking

_CLASSES: Final = 5
"""Classes that the table shows."""

_LOOKED_AT: Final = 100
"""Shapes that are looked at to say why none of them compares."""


@click.command()
@click.argument("mesh", type=mesh_path)
@place_options
@click.option("-k", type=click.IntRange(min=1), default=10, show_default=True, help="Number of shapes to print.")
@measure_option(VECTOR_MEASURES + PAIR_MEASURES + PART_MEASURES)
@classifier_option
@json_option
@parameter_options
@policy_options
def query(
    mesh: Path,
    library: str,
    url: str | None,
    k: int,
    measure: str,
    classifier: str,
    as_json: bool,
    parameters: Values,
    policy: Values,
) -> None:
    """Print the classes and shapes of the library that are nearest to MESH.

    Only shapes whose signatures were computed with the same parameters are compared. Reading policies may differ.
    """
    options = {"k": k, "measure": measure, "classifier": classifier}
    with open_place(library, url) as place:
        ranking = rank_file(place, mesh, parameters, policy, options)
        reason = "" if ranking.shapes else _why_nothing_compares(place, parameters, measure)
    if reason and as_json:
        warn(f"unbend: {reason}")
    print_result(ranking.as_dict(), reason or (lambda: _table(ranking)), as_json=as_json)


def _why_nothing_compares(place: Place, parameters: Values, measure: str) -> str:
    """Return the reason why no shape of `place` is compared with a signature of these parameters."""
    from unbend.signature.parameters import Parameters  # noqa: PLC0415
    from unbend.signature.signature import ALGORITHM_VERSION  # noqa: PLC0415

    shapes = place.page(limit=_LOOKED_AT).items
    if not shapes:
        return "the library has no shapes"
    wanted = asdict(Parameters.from_dict(parameters))
    stored = [asdict(shape.parameters) for shape in shapes]
    if wanted not in stored:
        names = [name for name in wanted if any(of[name] != wanted[name] for of in stored)]
        choices = sorted({_options(names, of) for of in stored})
        return (
            f"no shape compares with {_options(names, wanted)}: the library has {' and '.join(choices)}. Ask with its "
            "parameters, or import its shapes with these"
        )
    if all(shape.version != ALGORITHM_VERSION for shape in shapes):
        return f"an earlier version of unbend computed the shapes: import them again, for version {ALGORITHM_VERSION}"
    if measure in PART_MEASURES:
        return "no shape has local signatures: compute them by `unbend complete`"
    return f"none of the first {len(shapes)} shapes compares with this mesh"


def _options(names: list[str], parameters: Values) -> str:
    """Return some of the parameters as options of the command line."""
    return " ".join(f"--{name.replace('_', '-')} {parameters[name]}" for name in names)


def _part(part: PartRelation | None) -> str:
    """Return in words whether the mesh is a part of a shape, contains the shape, or matches it as a whole."""
    if not part:
        return ""
    words = {
        "part": "part of it, {:.0%} of its area, middle at {}",
        "contains": "contains it, {:.0%} of the area, middle at {}",
    }
    point = part.centre if part.relation == "contains" else part.place  # on the larger surface
    middle = " ".join(f"{coordinate:.4g}" for coordinate in point)
    return words.get(part.relation, "whole").format(part.covered, middle)


def _table(ranking: Ranking) -> str:
    classes = table(
        ["class", "distance", "confidence"],
        [[row.label, f"{row.distance:.4g}", f"{row.confidence:.2f}"] for row in ranking.classes[:_CLASSES]],
        numbers=("distance", "confidence"),
    )
    doubt = (
        "\nthe mesh is farther from the best class than the members of that class are from each other: "
        "it may belong to none of these classes"
        if ranking.known is False
        else ""
    )
    relations = [_part(row.part) for row in ranking.shapes]
    shown = any(relations)
    shapes = table(
        ["shape", "distance", "class", *(["relation"] if shown else [])],
        [
            [row.name, f"{row.distance:.4g}", row.label, *([relation] if shown else [])]
            for row, relation in zip(ranking.shapes, relations, strict=True)
        ],
        numbers=("distance",),
    )
    return f"{classes}{doubt}\n\n{shapes}"
