"""`unbend match`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from unbend.cli.computing import read_file
from unbend.cli.options import Values, mesh_path, output_option, policy_options, warn

if TYPE_CHECKING:
    from unbend.correspondence.correspondence import Correspondence
    from unbend.mesh.surface import Surface

ORIENTATIONS = ("keep", "reverse", "any")
PARTS = ("auto", "no", "a")

samples_option = click.option(
    "--samples", metavar="N", type=int, default=300, show_default=True, help="Farthest point samples of each mesh."
)
orientation_option = click.option(
    "--orientation",
    type=click.Choice(ORIENTATIONS),
    default="keep",
    show_default=True,
    help="Whether the match keeps the orientation of the triangles, which tells left from right, or reverses it.",
)


part_option = click.option(
    "--part",
    type=click.Choice(PARTS),
    default="auto",
    show_default=True,
    help="Whether the mesh whose vertices get points is a piece of the other: a, no, or auto, which looks at the "
    "boundary and the area.",
)


@click.command()
@click.argument("a", type=mesh_path)
@click.argument("b", type=mesh_path)
@output_option(
    "npz or json: the point of B for each vertex of A. ply, glb, obj or off: A in B's colours.", required=True
)
@click.option("--colours", type=click.Path(dir_okay=False, path_type=Path), help="Write B in these colours, too.")
@orientation_option
@part_option
@samples_option
@policy_options
def match(
    a: Path, b: Path, output: Path, colours: Path | None, orientation: str, part: str, samples: int, policy: Values
) -> None:
    """Find for each vertex of A the point of B that is the same place, however both are bent.

    A may be a piece of B, such as half of it, in the same unit of length.
    """
    from typing import Any, cast  # noqa: PLC0415

    from unbend.correspondence.export import export_correspondence, place_colours  # noqa: PLC0415
    from unbend.correspondence.match import match as find  # noqa: PLC0415
    from unbend.mesh.write import check_format, write_mesh  # noqa: PLC0415

    file_type = check_format(output.suffix.lower().lstrip("."))
    second_type = colours and check_format(colours.suffix.lower().lstrip("."))
    first, second = read_file(a, policy), read_file(b, policy)
    found = find(first, second, samples=samples, orientation=cast("Any", orientation), part=cast("Any", part))
    output.write_bytes(export_correspondence(found, first, second, file_type))
    if colours and second_type:
        colours.write_bytes(write_mesh(second.vertices, second.faces, second_type, colours=place_colours(second)))
    tell(output, found, second)


def tell(output: Path, found: Correspondence, target: Surface) -> None:
    """Print on standard error how good a correspondence is, and what makes it doubtful."""
    length = found.residual * float(target.area) ** 0.5
    share = f"{found.residual:.2%} of the square root of the area"
    warn(f"{output}: distances to near points change by {length:.4g} on average, {share}")
    if not found.oriented:
        warn(f"{output}: warning: the orientation of the triangles does not decide between mirrored matches")
    if found.ambiguous:
        warn(f"{output}: warning: a different match is nearly as good")
