"""`unbend query`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from unbend.cli.options import json_option, library_option, mesh_path, url_option


@click.command()
@click.argument("mesh", type=mesh_path)
@library_option
@url_option
@click.option("-k", type=click.IntRange(min=1), default=10, show_default=True, help="Shapes shown.")
@click.option("--measure", help="How signatures are compared.")
@json_option
def query(mesh: Path, library: str | None, url: str | None, k: int, measure: str | None, as_json: bool) -> None:
    """Say what MESH is, and what in the library is like it."""
    ranking = _over_http(mesh, url, k, measure) if url else _in_library(mesh, library or "unbend.db", k, measure)
    click.echo(json.dumps(ranking) if as_json else _table(ranking))


def _over_http(mesh: Path, url: str, k: int, measure: str | None) -> dict[str, Any]:
    from unbend.client import Client  # noqa: PLC0415

    with Client(url) as client:
        return client.query(mesh, measure=measure, k=k)


def _in_library(mesh: Path, url: str, k: int, measure: str | None) -> dict[str, Any]:
    from unbend.library import Library  # noqa: PLC0415
    from unbend.matching.measures import DEFAULT_MEASURE  # noqa: PLC0415
    from unbend.mesh.read import read_mesh  # noqa: PLC0415
    from unbend.signature.pipeline import compute_signature  # noqa: PLC0415

    with Library(url) as library:
        return library.rank(compute_signature(read_mesh(mesh)), measure=measure or DEFAULT_MEASURE, k=k).as_dict()


def _table(ranking: dict[str, Any]) -> str:
    if not ranking["shapes"]:
        return "the library holds nothing to compare with"
    lines = [f"{'class':<24}{'distance':>12}{'confidence':>12}"]
    lines += [f"{row['label']:<24}{row['distance']:>12.4g}{row['confidence']:>12.2f}" for row in ranking["classes"][:5]]
    if ranking["known"] is False:
        lines.append("farther than the nearest class' members are from each other: it may be none of these")
    lines += ["", f"{'shape':<24}{'distance':>12}  class"]
    lines += [f"{row['name']:<24}{row['distance']:>12.4g}  {row['label'] or '-'}" for row in ranking["shapes"]]
    return "\n".join(lines)
