"""`unbend compare`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.mesh_file import compute_file
from unbend.cli.options import (
    PAIR_MEASURES,
    VECTOR_MEASURES,
    Values,
    json_option,
    measure_option,
    mesh_path,
    parameter_options,
    policy_options,
)
from unbend.cli.terminal import print_result


@click.command()
@click.argument("a", type=mesh_path)
@click.argument("b", type=mesh_path)
@measure_option(VECTOR_MEASURES + PAIR_MEASURES)
@json_option
@parameter_options
@policy_options
def compare(a: Path, b: Path, measure: str, as_json: bool, parameters: Values, policy: Values) -> None:
    """Print the distance between the shapes A and B; equal shapes have distance 0."""
    from unbend.matching.measures import compare as distance  # noqa: PLC0415

    first, second = (compute_file(mesh, parameters, policy) for mesh in (a, b))
    found = float(distance(first, second, measure))
    print_result({"measure": measure, "distance": found}, f"{found:.6g}", as_json=as_json)
