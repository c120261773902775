"""`unbend query`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from unbend.brief import counted
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
from unbend.cli.places import open_place, rank_file
from unbend.cli.reasons import GIVE_CLASSES, why_nothing_compares
from unbend.cli.tables import table, visible
from unbend.cli.terminal import print_result
from unbend.errors import UnsuitedError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from unbend.matching.classification import ClassMatch
    from unbend.results.rankings import PartRelation, Ranking

_CLASSES: Final = 5
"""Classes that the table shows on a terminal."""

_ID_SHOWN: Final = 8
"""Digits of an id that the table shows on a terminal."""


def _metadata(_context: click.Context, _option: click.Parameter, given: Sequence[str]) -> dict[str, Any]:
    """Return the members of metadata that the option --where names."""
    found: dict[str, Any] = {}
    for each in given:
        name, sign, text = each.partition("=")
        if not sign:
            raise click.BadParameter(f"{each!r} should be NAME=VALUE")
        try:
            found[name] = json.loads(text)
        except ValueError:
            found[name] = text
    return found


@click.command()
@click.argument("mesh", type=mesh_path)
@place_options
@click.option("-k", type=click.IntRange(min=1), default=10, show_default=True, help="Number of shapes to print.")
@measure_option(
    VECTOR_MEASURES + PAIR_MEASURES + PART_MEASURES,
    description=f"Measure that compares the signatures. {', '.join(PAIR_MEASURES)} compare only shapes: classes and "
    f"their distances are then those of {VECTOR_MEASURES[0]}.",
)
@classifier_option
@click.option("--exact", is_flag=True, help="Compare every shape, even if the database has an approximate index.")
@click.option("--label", metavar="CLASS", help="Compare only shapes of this class.")
@click.option(
    "--where",
    metavar="NAME=VALUE",
    multiple=True,
    callback=_metadata,
    help="Compare only shapes whose metadata have this value: JSON, or text. Can be repeated.",
)
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
    exact: bool,
    label: str | None,
    where: dict[str, Any],
    as_json: bool,
    parameters: Values,
    policy: Values,
) -> None:
    """Print the classes and shapes of the library that are nearest to MESH.

    Only shapes whose signatures were computed with the same parameters are compared. Reading policies may differ. It is
    an error if there are none.

    The line after the classes says if MESH may belong to none of them, or if unbend cannot tell. A terminal shows the
    nearest classes and the beginning of each id. A pipe gets all of them.
    """
    options = {
        "k": k, "measure": measure, "classifier": classifier, "exact": exact, "label": label, "metadata": where,
    }  # fmt: skip
    with open_place(library, url) as place:
        ranking = rank_file(place, mesh, parameters, policy, options)
        if not ranking.shapes:
            raise why_nothing_compares(place, parameters, measure) or UnsuitedError("no shape compares with this mesh")
    print_result(ranking.as_dict(), lambda: _text(ranking), as_json=as_json)


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


def _text(ranking: Ranking) -> str:
    """Return the classes, what is to be said about them, and the shapes."""
    on_terminal = sys.stdout.isatty()
    shown = ranking.classes[:_CLASSES] if on_terminal else ranking.classes
    left_out = len(ranking.classes) - len(shown)
    lines = [
        _classes(ranking, shown) if shown else "",
        f"and {counted(left_out, 'more class', 'more classes')}; --json prints all" if left_out else "",
        _doubt(ranking),
    ]
    return "\n".join(filter(None, lines)) + f"\n\n{_shapes(ranking, on_terminal)}"


def _classes(ranking: Ranking, shown: Sequence[ClassMatch]) -> str:
    distance = f"distance ({VECTOR_MEASURES[0]})" if ranking.measure in PAIR_MEASURES else "distance"
    rows = [[row.label, f"{row.distance:.4g}", f"{row.confidence:.2f}"] for row in shown]
    return table(["class", distance, "confidence"], rows, numbers=(distance, "confidence"))


def _doubt(ranking: Ranking) -> str:
    """Return why the mesh may not belong to the best class, or why unbend cannot tell; empty if it belongs to it."""
    if not ranking.classes:
        return f"none of the compared shapes has a class. {GIVE_CLASSES}"
    best = visible(ranking.classes[0].label)
    if ranking.known is None:
        other = ", or the mesh contains its shape" if ranking.measure in PART_MEASURES else ""
        return f"{best} has one shape to compare with{other}: unbend cannot tell whether the mesh belongs to it"
    if not ranking.known:
        return (
            f"the mesh is farther from its nearest {best} than a {best} usually is from its own nearest neighbour: "
            "it may belong to none of these classes"
        )
    return ""


def _shapes(ranking: Ranking, on_terminal: bool) -> str:
    distance = f"distance ({ranking.measure})" if ranking.measure in PAIR_MEASURES else "distance"
    digits = _ID_SHOWN if on_terminal else None
    relations = [_part(row.part) for row in ranking.shapes]
    related = any(relations)
    return table(
        ["shape", distance, "class", "id", *(["relation"] if related else [])],
        [
            [row.name, f"{row.distance:.4g}", row.label, row.id[:digits], *([relation] if related else [])]
            for row, relation in zip(ranking.shapes, relations, strict=True)
        ],
        numbers=(distance,),
    )
