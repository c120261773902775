"""`unbend compare`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.computing import compute_file
from unbend.cli.options import Values, mesh_path, parameter_options, policy_options


@click.command()
@click.argument("a", type=mesh_path)
@click.argument("b", type=mesh_path)
@click.option("--measure", help="How signatures are compared.")
@parameter_options
@policy_options
def compare(a: Path, b: Path, measure: str | None, parameters: Values, policy: Values) -> None:
    """Print how far the shapes A and B are apart: 0 for the same."""
    from unbend.matching.measures import DEFAULT_MEASURE  # noqa: PLC0415
    from unbend.matching.measures import compare as distance  # noqa: PLC0415

    first, second = (compute_file(mesh, parameters, policy) for mesh in (a, b))
    click.echo(f"{distance(first, second, measure or DEFAULT_MEASURE):.6g}")
