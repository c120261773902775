"""`unbend symmetry`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.match import doubts, figures, quality, samples_option
from unbend.cli.mesh_file import read_file
from unbend.cli.options import Values, json_option, mesh_path, output_option, policy_options
from unbend.cli.terminal import confirm_file, warn_of


@click.command()
@click.argument("mesh", type=mesh_path)
@output_option(
    "npz or json: the mirror image of each vertex. "
    "ply, glb, obj or off: MESH, each vertex coloured by the place of its mirror image.",
    required=True,
)
@samples_option
@json_option
@policy_options
def symmetry(mesh: Path, output: Path, samples: int, as_json: bool, policy: Values) -> None:
    """Find the intrinsic mirror image of MESH: for each vertex its counterpart, such as the other hand's thumb."""
    from unbend.correspondence.export import export_correspondence  # noqa: PLC0415
    from unbend.correspondence.symmetry import symmetry as find  # noqa: PLC0415
    from unbend.mesh.write import check_format  # noqa: PLC0415

    file_type = check_format(output.suffix.lower().lstrip("."))
    surface = read_file(mesh, policy)
    found = find(surface, samples=samples)
    output.write_bytes(export_correspondence(found, surface, surface, file_type))
    warn_of(output, doubts(found))
    confirm_file(output, quality(found, surface), figures(found, surface), as_json=as_json)
