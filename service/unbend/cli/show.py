"""`unbend show`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, get_args

import click

from unbend.cli.mesh_file import read_file
from unbend.cli.options import (
    Values,
    json_option,
    mesh_path,
    output_option,
    parameter_options,
    place_options,
    policy_options,
)
from unbend.cli.places import may_begin_id, open_place, whole_id
from unbend.cli.terminal import confirm_file, prepare_kernels, print_result
from unbend.names import is_shape_id, printable

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from unbend.mesh.surface import Surface
    from unbend.render.request import PictureRequest
    from unbend.results import ShapeRecord

SUBJECTS = ("surface", "signature", "both")
THEMES = ("light", "dark", "transparent")
UPS = ("auto", "x", "y", "z")

_OPTIONS: Final = {
    "distances_from": "--from",
    "path": "--from or --to",
    "dimension": "--dimension",
    "contours": "--contours",
}
"""The options of fields of a picture's request that have other names."""

_FIELD: Final = re.compile(r"^(path|contours|dimension)\b|distances_from|(?<=or )dimension\b")
"""A field in an error: at its beginning, or where it cannot be another word."""


def _size(_context: click.Context, _option: click.Parameter, value: str) -> tuple[int, int]:
    width, cross, height = value.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise click.BadParameter(f"{value!r} is not like 800x600: width and height in pixels")
    return int(width), int(height)


class _MeshOrId(click.ParamType):  # type: ignore[type-arg]  # not generic in old versions of click
    """A mesh file, or the id of a stored shape or its beginning. A file of the same name comes first."""

    name = "mesh"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path | str:
        if isinstance(value, str) and (is_shape_id(value) or (may_begin_id(value) and not Path(value).exists())):
            return value
        return Path(mesh_path.convert(str(value), param, ctx))

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        return mesh_path.shell_complete(ctx, param, incomplete)


@click.command()
@click.argument("source", metavar="MESH|ID", type=_MeshOrId())
@output_option("A png or webp file; needed to draw.")
@place_options
@json_option
@click.option("--subject", type=click.Choice(SUBJECTS), default="surface", show_default=True, help="What to show.")
@click.option("--size", metavar="WxH", default="512x512", show_default=True, callback=_size, help="In pixels.")
@click.option("--theme", type=click.Choice(THEMES), default="light", show_default=True, help="Background and colours.")
@click.option("--from", "start", metavar="VERTEX", type=int, help="Show geodesic distances from this vertex.")
@click.option("--to", "target", metavar="VERTEX", type=int, help="With --from: show the shortest path to this vertex.")
@click.option("--dimension", metavar="N", type=int, help="Show coordinate N of the signature, 4 to 6, by colours.")
@click.option("--contours", is_flag=True, help="Draw contours of the distances, or of the coordinate.")
@click.option("--azimuth", metavar="DEGREES", type=float, help="Direction of view, 0 from the front.")
@click.option("--elevation", metavar="DEGREES", type=float, default=14.0, show_default=True, help="Height of the eye.")
@click.option("--up", type=click.Choice(UPS), default="auto", show_default=True, help="Upright axis of MESH.")
@parameter_options
@policy_options
def show(
    source: Path | str,
    output: Path | None,
    library: str,
    url: str | None,
    as_json: bool,
    subject: str,
    size: tuple[int, int],
    theme: str,
    start: int | None,
    target: int | None,
    dimension: int | None,
    contours: bool,
    azimuth: float | None,
    elevation: float,
    up: str,
    parameters: Values,
    policy: Values,
) -> None:
    """Draw MESH, its signature, or both, as a picture; or print or draw the stored shape ID.

    The parameters of the signature matter only if the signature is shown. With --dimension N, --dimensions is N by
    default. A stored shape is drawn with its own parameters and policy, unless options override them.
    The first digits of an ID suffice, 6 or more, if no other shape has the same.
    """
    from unbend.errors import ParameterError, check_choice  # noqa: PLC0415
    from unbend.render.request import Format, PictureRequest  # noqa: PLC0415

    if output is None:
        if isinstance(source, Path):
            raise click.UsageError("drawing a mesh needs -o, the file of the picture")
        with open_place(library, url) as place:
            record = place.get(whole_id(place, source))
        print_result(record.as_dict(), lambda: _lines(record), as_json=as_json)
        return
    if target is not None and start is None:
        raise ParameterError("--to goes with --from only: a path has two ends")
    file_type = output.suffix.lower().lstrip(".")
    check_choice("the output's format", file_type, get_args(Format))
    given = {
        "width": size[0],
        "height": size[1],
        "format": file_type,
        "subject": subject,
        "theme": theme,
        "azimuth": azimuth,
        "elevation": elevation,
        "up": up,
        "distances_from": None if dimension is not None and target is not None else start,
        "dimension": dimension,
        "contours": contours,
        "path": None if start is None or target is None else (start, target),
    }
    with _naming_options():
        request = PictureRequest.from_dict(given)
    if dimension is not None:
        parameters = {"dimensions": dimension} | parameters
    if isinstance(source, Path):
        surface = read_file(source, policy)
    else:
        with open_place(library, url) as place:
            record = place.get(whole_id(place, source))
            data = place.mesh(record.id)
        parameters = record.parameters.as_dict() | parameters
        surface = _read(data, record, policy)
    with _naming_options():
        stress = _draw(request, surface, parameters, output)
    text = f"{size[0]} x {size[1]} pixels" + ("" if stress is None else f", stress {stress:.4g}")
    confirm_file(output, text, {"width": size[0], "height": size[1], "stress": stress}, as_json=as_json)


@contextmanager
def _naming_options() -> Iterator[None]:
    """Let errors of a picture name the options of this command instead of the fields of a request."""
    from unbend.errors import ParameterError  # noqa: PLC0415

    try:
        yield
    except ParameterError as error:
        error.args = (_FIELD.sub(lambda found: _OPTIONS[found[0]], str(error)),)
        raise


def _read(data: bytes, record: ShapeRecord, policy: Values) -> Surface:
    """Return the surface of a stored shape. Its record has the notes of reading it."""
    from unbend.mesh.policy import MeshPolicy  # noqa: PLC0415
    from unbend.mesh.read import read_mesh  # noqa: PLC0415

    prepare_kernels()
    chosen = MeshPolicy.from_dict(record.policy.as_dict() | policy)
    return read_mesh(data, file_type=record.file_type, policy=chosen)


def _draw(request: PictureRequest, surface: Surface, parameters: Values, output: Path) -> float | None:
    """Write the picture; return the stress of the signature if it is shown."""
    from unbend.render.picture import render_picture  # noqa: PLC0415
    from unbend.signature.canonical_form import canonical_form  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    chosen = Parameters.from_dict(parameters)
    form = canonical_form(surface, chosen) if request.needs_form else None
    output.write_bytes(render_picture(request, surface, form))
    return None if form is None else float(form.signature.stress)


def _lines(record: ShapeRecord) -> str:
    """Return a record with a line for each field; the notes and warnings of reading the mesh come last."""
    fields = {name: value for name, value in record.as_dict().items() if name not in {"report", "warnings"}}
    width = max(map(len, fields)) + 2
    lines = [f"{name:<{width}}{_text(value)}" for name, value in fields.items()]
    lines += [f"{'note':<{width}}{note}" for note in record.report.get("notes", ())]
    lines += [f"{'warning':<{width}}{warning}" for warning in record.warnings]
    return "\n".join(lines)


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name}={content}" for name, content in value.items()) or "-"
    return "-" if value is None else printable(str(value))
