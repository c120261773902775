"""`unbend compare`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.computing import compute_file
from unbend.cli.options import Values, mesh_path, parameter_options, policy_options


@click.command()
@click.argument("a", type=mesh_path)
@click.argument("b", type=mesh_path)
@click.option("--measure", help="Measure that compares the signatures.")
@parameter_options
@policy_options
def compare(a: Path, b: Path, measure: str | None, parameters: Values, policy: Values) -> None:
    """Print the distance between the shapes A and B; equal shapes have distance 0."""
    from unbend.matching.measures import DEFAULT_MEASURE, get_measure  # noqa: PLC0415
    from unbend.matching.measures import compare as distance  # noqa: PLC0415

    get_measure(measure or DEFAULT_MEASURE)  # an unknown measure fails before anything is computed
    first, second = (compute_file(mesh, parameters, policy) for mesh in (a, b))
    click.echo(f"{distance(first, second, measure or DEFAULT_MEASURE):.6g}")
