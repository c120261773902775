"""`unbend signature`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.computing import compute_file
from unbend.cli.options import Values, mesh_path, parameter_options, policy_options, warn


@click.command()
@click.argument("mesh", type=mesh_path)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="A ply, obj, off, glb, npz or json file; json on standard output by default.",
)
@parameter_options
@policy_options
def signature(mesh: Path, output: Path | None, parameters: Values, policy: Values) -> None:
    """Compute the signature of MESH."""
    from unbend.mesh.write import check_format  # noqa: PLC0415
    from unbend.signature.export import export_signature  # noqa: PLC0415

    file_type = check_format(output.suffix.lower().lstrip(".") if output else "json")
    found = compute_file(mesh, parameters, policy, tell=True)
    data = export_signature(found, file_type)
    if output:
        output.write_bytes(data)
        warn(f"{output}: {len(found.points)} points in {found.points.shape[1]} dimensions, stress {found.stress:.4g}")
    else:
        click.echo(data.decode())
