"""`unbend symmetry`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.computing import read_file
from unbend.cli.match import samples_option, tell
from unbend.cli.options import Values, mesh_path, output_option, policy_options


@click.command()
@click.argument("mesh", type=mesh_path)
@output_option(
    "npz or json: the mirror image of each vertex. "
    "ply, glb, obj or off: MESH, each vertex coloured by the place of its mirror image.",
    required=True,
)
@samples_option
@policy_options
def symmetry(mesh: Path, output: Path, samples: int, policy: Values) -> None:
    """Find the intrinsic mirror image of MESH: for each vertex its counterpart, such as the other hand's thumb."""
    from unbend.correspondence.export import export_correspondence  # noqa: PLC0415
    from unbend.correspondence.symmetry import symmetry as find  # noqa: PLC0415
    from unbend.mesh.write import check_format  # noqa: PLC0415

    file_type = check_format(output.suffix.lower().lstrip("."))
    surface = read_file(mesh, policy)
    found = find(surface, samples=samples)
    output.write_bytes(export_correspondence(found, surface, surface, file_type))
    tell(output, found, surface)
