"""`unbend flatten`."""

from __future__ import annotations

from pathlib import Path

import click

from unbend.cli.mesh_file import read_file
from unbend.cli.options import Values, json_option, mesh_path, output_option, parameter_options, policy_options
from unbend.cli.terminal import confirm_file


@click.command()
@click.argument("mesh", type=mesh_path)
@output_option("An obj, glb, npz or json file: MESH with texture coordinates.", required=True)
@json_option
@parameter_options
@policy_options
def flatten(mesh: Path, output: Path, as_json: bool, parameters: Values, policy: Values) -> None:
    """Flatten MESH into the plane, and write it with the resulting texture coordinates.

    Sheet-like surfaces give good results. A closed surface is flattened into two layers: cut it open first.
    """
    from unbend.mesh.write import TEXTURE_FORMATS, check_format  # noqa: PLC0415
    from unbend.signature.flattening import export_flattening  # noqa: PLC0415
    from unbend.signature.flattening import flatten as lay_flat  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    file_type = check_format(output.suffix.lower().lstrip("."), TEXTURE_FORMATS)
    found = lay_flat(read_file(mesh, policy), Parameters.from_dict(parameters))
    output.write_bytes(export_flattening(found, file_type))
    figures = {name: getattr(found, name) for name in ("mean_distortion", "max_distortion", "flipped", "stress")}
    confirm_file(
        output,
        f"lengths change by a factor of {found.mean_distortion:.4g} on average, {found.max_distortion:.4g} at most; "
        f"{found.flipped:.1%} of the area is turned over; stress {found.stress:.4g}",
        figures,
        as_json=as_json,
    )
