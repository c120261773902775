"""`unbend show`."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import click

from unbend.cli.computing import read_file
from unbend.cli.options import Values, mesh_path, output_option, parameter_options, policy_options, warn

SUBJECTS = ("surface", "signature", "both")
THEMES = ("light", "dark", "transparent")
UPS = ("auto", "x", "y", "z")


def _size(_context: click.Context, _option: click.Parameter, value: str) -> tuple[int, int]:
    width, cross, height = value.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise click.BadParameter(f"{value!r} is not like 800x600: width and height in pixels")
    return int(width), int(height)


@click.command()
@click.argument("mesh", type=mesh_path)
@output_option("A png or webp file.", required=True)
@click.option("--subject", type=click.Choice(SUBJECTS), default="surface", show_default=True, help="What to show.")
@click.option("--size", metavar="WxH", default="512x512", show_default=True, callback=_size, help="In pixels.")
@click.option("--theme", type=click.Choice(THEMES), default="light", show_default=True, help="Background and colours.")
@click.option("--from", "source", metavar="VERTEX", type=int, help="Show geodesic distances from this vertex.")
@click.option("--to", "target", metavar="VERTEX", type=int, help="With --from: show the shortest path to this vertex.")
@click.option("--dimension", metavar="N", type=int, help="Show coordinate N of the signature, 4 to 6, by colours.")
@click.option("--contours", is_flag=True, help="Draw contours of the distances, or of the coordinate.")
@click.option("--azimuth", metavar="DEGREES", type=float, help="Direction of view, 0 from the front.")
@click.option("--elevation", metavar="DEGREES", type=float, default=14.0, show_default=True, help="Height of the eye.")
@click.option("--up", type=click.Choice(UPS), default="auto", show_default=True, help="Upright axis of MESH.")
@parameter_options
@policy_options
def show(
    mesh: Path,
    output: Path,
    subject: str,
    size: tuple[int, int],
    theme: str,
    source: int | None,
    target: int | None,
    dimension: int | None,
    contours: bool,
    azimuth: float | None,
    elevation: float,
    up: str,
    parameters: Values,
    policy: Values,
) -> None:
    """Draw MESH, its signature, or both, as a picture.

    The parameters of the signature matter only if the signature is shown. With --dimension N, --dimensions is N by
    default.
    """
    from unbend.errors import ParameterError, check_choice  # noqa: PLC0415
    from unbend.render.picture import render_picture  # noqa: PLC0415
    from unbend.render.request import Format, PictureRequest  # noqa: PLC0415
    from unbend.signature.canonical_form import canonical_form  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    if target is not None and source is None:
        raise ParameterError("--to goes with --from only: a path has two ends")
    file_type = output.suffix.lower().lstrip(".")
    check_choice("the output's format", file_type, get_args(Format))
    request = PictureRequest.from_dict(
        {
            "width": size[0],
            "height": size[1],
            "format": file_type,
            "subject": subject,
            "theme": theme,
            "azimuth": azimuth,
            "elevation": elevation,
            "up": up,
            "distances_from": None if dimension is not None and target is not None else source,
            "dimension": dimension,
            "contours": contours,
            "path": None if source is None or target is None else (source, target),
        }
    )
    if dimension is not None:
        parameters = {"dimensions": dimension} | parameters
    chosen = Parameters.from_dict(parameters)
    surface = read_file(mesh, policy)
    form = canonical_form(surface, chosen) if request.needs_form else None
    output.write_bytes(render_picture(request, surface, form))
    stress = "" if form is None else f", stress {form.signature.stress:.4g}"
    warn(f"{output}: {size[0]} x {size[1]} pixels{stress}")
