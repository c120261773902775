"""`unbend query`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from unbend.cli.computing import compute_file
from unbend.cli.connect import connect
from unbend.cli.options import (
    Values,
    json_option,
    library_option,
    mesh_path,
    parameter_options,
    policy_options,
    url_option,
    warn_of,
)
from unbend.names import DEFAULT_LIBRARY


@click.command()
@click.argument("mesh", type=mesh_path)
@library_option
@url_option
@click.option("-k", type=click.IntRange(min=1), default=10, show_default=True, help="Number of shapes to print.")
@click.option("--measure", help="Measure that compares the signatures.")
@click.option("--classifier", help="The rule that turns distances from shapes into distances from classes.")
@json_option
@parameter_options
@policy_options
def query(
    mesh: Path,
    library: str | None,
    url: str | None,
    k: int,
    measure: str | None,
    classifier: str | None,
    as_json: bool,
    parameters: Values,
    policy: Values,
) -> None:
    """Print the classes and shapes of the library that are nearest to MESH.

    Only shapes whose signatures were computed with the same parameters are compared. Reading policies may differ.
    """
    chosen = {"measure": measure, "classifier": classifier}
    options = {"k": k} | {name: value for name, value in chosen.items() if value}
    if url:
        ranking = _over_http(url, mesh, parameters, policy, options)
    else:
        ranking = _in_library(library or DEFAULT_LIBRARY, mesh, parameters, policy, options)
    click.echo(json.dumps(ranking) if as_json else _table(ranking))
    if url:  # without a service, `compute_file` has printed the warnings
        warn_of(mesh.name, ranking.get("warnings", ()))


def _over_http(url: str, mesh: Path, parameters: Values, policy: Values, options: Values) -> Values:
    with connect(url) as client:
        return client.rank(mesh, parameters=parameters, policy=policy, **options).as_dict()


def _in_library(url: str, mesh: Path, parameters: Values, policy: Values, options: Values) -> Values:
    from unbend.library import Library  # noqa: PLC0415
    from unbend.matching.partial import PART_MEASURES  # noqa: PLC0415

    local = options.get("measure") in PART_MEASURES
    with Library(url) as library:
        return library.rank(compute_file(mesh, parameters, policy, local=local), **options).as_dict()


def _part(part: Values | None) -> str:
    """Return in words whether the mesh is a part of a shape, contains the shape, or matches it as a whole."""
    if not part:
        return ""
    words = {
        "part": "part of it, {:.0%} of its area, middle at {}",
        "contains": "contains it, {:.0%} of the area, middle at {}",
    }
    point = part["centre" if part["relation"] == "contains" else "place"]  # on the larger surface
    middle = " ".join(f"{coordinate:.4g}" for coordinate in point)
    return "  " + words.get(part["relation"], "whole").format(part["covered"], middle)


def _table(ranking: Values) -> str:
    if not ranking["shapes"]:
        return "the library has no shapes to compare with"
    lines = [f"{'class':<24}{'distance':>12}{'confidence':>12}"]
    lines += [f"{row['label']:<24}{row['distance']:>12.4g}{row['confidence']:>12.2f}" for row in ranking["classes"][:5]]
    if ranking["known"] is False:
        lines.append(
            "the mesh is farther from the best class than the members of that class are from each other: "
            "it may belong to none of these classes"
        )
    lines += ["", f"{'shape':<24}{'distance':>12}  class"]
    lines += [
        f"{row['name']:<24}{row['distance']:>12.4g}  {row['label'] or '-'}{_part(row.get('part'))}"
        for row in ranking["shapes"]
    ]
    return "\n".join(lines)
