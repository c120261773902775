"""`unbend signature`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.computing import read_file
from unbend.cli.options import Values, mesh_path, output_option, parameter_options, policy_options
from unbend.cli.terminal import stages, warn


@click.command()
@click.argument("mesh", type=mesh_path)
@output_option("A ply, obj, off, glb, npz or json file; json on standard output by default.")
@click.option("--whole", is_flag=True, help="Place every vertex, not only the samples: the form at full resolution.")
@parameter_options
@policy_options
def signature(mesh: Path, output: Path | None, whole: bool, parameters: Values, policy: Values) -> None:
    """Compute the signature of MESH."""
    from unbend.mesh.write import check_format  # noqa: PLC0415
    from unbend.signature.canonical_form import canonical_form  # noqa: PLC0415
    from unbend.signature.export import export_form, export_signature  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415
    from unbend.signature.pipeline import compute_signature  # noqa: PLC0415

    file_type = check_format(output.suffix.lower().lstrip(".") if output else "json")
    chosen = Parameters.from_dict(parameters)
    surface = read_file(mesh, policy)
    with stages(mesh.name) as report:
        found = compute_signature(surface, chosen, progress=report)
    if whole:
        form = canonical_form(surface, signature=found)
        data, points = export_form(form, file_type), form.points
    else:
        data, points = export_signature(found, file_type), found.points
    if output:
        output.write_bytes(data)
        warn(f"{output}: {len(points):,} points in {points.shape[1]} dimensions, stress {found.stress:.4g}")
    else:
        click.echo(data.decode())
