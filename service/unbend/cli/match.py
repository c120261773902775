"""`unbend match`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from unbend.cli.mesh_file import read_file
from unbend.cli.options import Values, json_option, mesh_path, output_option, policy_options
from unbend.cli.terminal import confirm_file, warn_of

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
@json_option
@policy_options
def match(
    a: Path,
    b: Path,
    output: Path,
    colours: Path | None,
    orientation: str,
    part: str,
    samples: int,
    as_json: bool,
    policy: Values,
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
    warn_of(output, doubts(found))
    confirm_file(output, quality(found, second), figures(found, second), as_json=as_json)


def quality(found: Correspondence, target: Surface) -> str:
    """Return in words how good a correspondence is."""
    share = f"{found.residual:.2%} of the square root of the area"
    return f"distances to near points change by {_length(found, target):.4g} on average, {share}"


def doubts(found: Correspondence) -> list[str]:
    """Return what makes a correspondence doubtful."""
    sentences = []
    if not found.oriented:
        sentences.append("the orientation of the triangles does not decide between mirrored matches")
    if found.ambiguous:
        sentences.append("a different match is nearly as good")
    return sentences


def figures(found: Correspondence, target: Surface) -> Values:
    """Return `quality` and `doubts` as JSON values."""
    return {"residual": found.residual, "change": _length(found, target), "warnings": doubts(found)}


def _length(found: Correspondence, target: Surface) -> float:
    return found.residual * math.sqrt(target.area)
