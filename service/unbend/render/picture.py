"""`render_picture`: a surface, its signature, or both, as the bytes of an image file."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from unbend.arrays import Floats
from unbend.errors import ParameterError, UnsuitedError
from unbend.geodesics.distances import check_vertices, geodesic_distances
from unbend.geodesics.paths.shortest import geodesic_path
from unbend.mesh.surface import Surface
from unbend.render.carry import carry
from unbend.render.colours import THEMES, Colour, Theme
from unbend.render.draw import render_scene
from unbend.render.request import Format, PictureRequest
from unbend.render.scene import Field, Item, Scene, SceneMesh, Sphere, Tube
from unbend.render.upright import upright_axis
from unbend.render.view import Axis, default_azimuth, fit_camera, view_axes
from unbend.signature.canonical_form import CanonicalForm, in_space
from unbend.signature.orientation import orient_form

CONTOUR_STEPS: Final = 16
"""Number of steps between the least value of a field and its largest, which contours separate."""

GAP: Final = 0.12
"""Gap between a surface and its signature, as a share of the wider of them."""

TUBE_RADIUS: Final = 0.008
"""Radius of a path, as a share of the diagonal of the box around the surface."""

_LIFT: Final = 0.3  # height of a path above the surface, as a share of the path's radius
_MARKER: Final = 2.2  # radius of a marker, in radii of a path
_WEBP_QUALITY: Final = 90


def render_picture(
    request: PictureRequest, surface: Surface, form: CanonicalForm | None = None, *, threads: int | None = None
) -> bytes:
    r"""Draw a surface, its signature, or one beside the other, and return the file.

    Parameters
    ----------
    request : PictureRequest
    surface : Surface
    form : CanonicalForm, optional
        The form of this surface; needed if `request.needs_form`.
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    bytes
        A file of `request.format`, the same for the same input, on every run.

    Raises
    ------
    ParameterError
        If the form is missing, or not of this surface, a vertex of the request does not exist, or `threads` is below 1.
    UnsuitedError
        If the form has too few dimensions to show, no path leads between the ends of `request.path`, or no face uses
        one of its vertices.

    Examples
    --------
    >>> from unbend.mesh.shapes import torus
    >>> from unbend.render.request import PictureRequest
    >>> render_picture(PictureRequest(width=64, height=48), torus())[:4]
    b'\x89PNG'
    """
    return encode(render_pixels(request, surface, form, threads=threads), request.format)


def render_pixels(
    request: PictureRequest, surface: Surface, form: CanonicalForm | None = None, *, threads: int | None = None
) -> NDArray[np.uint8]:
    """Return the pixels of `render_picture`, (h, w, 4) as `render_scene` gives them."""
    if request.needs_form:
        _check_form(request, surface, form)
    theme = THEMES[request.theme]
    up: Axis = upright_axis(surface) if request.up == "auto" else request.up
    unit = surface.scale  # so that products of lengths stay in the range of double precision
    used = surface.vertices[surface.used_vertices] / unit
    azimuth = default_azimuth(used, up) if request.azimuth is None else request.azimuth
    axes = view_axes(azimuth, request.elevation, up)
    content = _content(request, surface, form, theme, threads)
    size = request.width, request.height
    places = []
    if request.subject != "signature":
        places.append(_Place(surface.vertices / unit, theme.surface, content.path))
    if request.subject != "surface" and form is not None:
        points = form_in_space(form, surface) / unit
        path = content.path
        if path is not None:
            path = carry(surface.vertices / unit, surface.faces, path, points)
        places.append(_Place(points, theme.signature, path))
    items, shown = _side_by_side(places, surface, content, theme, axes)
    return render_scene(Scene(items), fit_camera(shown, axes, size), size, theme, threads=threads)


def form_in_space(form: CanonicalForm, surface: Surface) -> Floats:
    """Return the first three coordinates of a form, turned as the surface stands and in its unit, (n, 3).

    Coordinates that a form of fewer dimensions lacks are 0 before it is turned. NaN at vertices that no face uses.
    """
    points = np.full((len(form.points), 3), np.nan)
    known = np.isfinite(form.points).all(axis=1)
    points[known] = in_space(form.points[known])
    return orient_form(points * form.signature.scale, surface.vertices, surface.vertex_areas)


def encode(pixels: NDArray[np.uint8], file_type: Format) -> bytes:
    """Return an image file of pixels (h, w, 4); without an alpha channel if all are opaque."""
    opaque = bool((pixels[..., 3] == 255).all())
    image = Image.fromarray(np.ascontiguousarray(pixels[..., :3]) if opaque else pixels)
    target = io.BytesIO()
    if file_type == "webp":
        image.save(target, "WEBP", quality=_WEBP_QUALITY)
    else:
        image.save(target, "PNG")
    return target.getvalue()


@dataclass(frozen=True, eq=False)
class _Content:
    """The things that a request puts on a surface and on its form alike, in units of `Surface.scale`."""

    field: Field | None
    path: Floats | None
    marked: tuple[tuple[int, Colour], ...]


@dataclass(frozen=True, eq=False)
class _Place:
    """The places of the vertices on the surface or on its form, their colour, and the path there, in the same units."""

    points: Floats
    colour: Colour
    path: Floats | None


def _check_form(request: PictureRequest, surface: Surface, form: CanonicalForm | None) -> None:
    if form is None:
        raise ParameterError("form: this picture needs the canonical form of the surface")
    if len(form.points) != len(surface.vertices) or not np.array_equal(form.faces, surface.faces):
        raise ParameterError("form: it is the form of another surface")
    if request.dimension is not None and form.points.shape[1] < request.dimension:
        raise UnsuitedError(
            f"dimension: the signature has {form.points.shape[1]} dimensions, and so no dimension {request.dimension}"
        )


def _content(
    request: PictureRequest, surface: Surface, form: CanonicalForm | None, theme: Theme, threads: int | None
) -> _Content:
    field, path, marked = None, None, dict[int, Colour]()
    steps = CONTOUR_STEPS if request.contours else 0
    if request.distances_from is not None:
        vertex = _vertex(surface, request.distances_from, "distances_from")
        values = geodesic_distances(surface, vertex, threads=threads)[0] / surface.scale
        field = Field(values, "viridis", low=0.0, contours=steps)
        marked[vertex] = theme.start
    if request.dimension is not None and form is not None:
        values = form.points[:, request.dimension - 1]
        most = float(np.nanmax(np.abs(values)))
        field = Field(np.where(np.isnan(values), np.inf, values), "coolwarm", low=-most, high=most, contours=steps)
    if request.path is not None:
        start, end = (_vertex(surface, vertex, "path") for vertex in request.path)
        path = geodesic_path(surface, start, end) / surface.scale
        marked |= {start: theme.start, end: theme.end}
    return _Content(field, path, tuple(marked.items()))


def _vertex(surface: Surface, vertex: int, name: str) -> int:
    """Return a vertex of a face, or raise ParameterError or UnsuitedError."""
    (found,) = check_vertices(surface, vertex, name)
    if not (surface.used_vertices == found).any():
        raise UnsuitedError(f"{name}: no face uses vertex {vertex}")
    return int(found)


def _side_by_side(
    places: list[_Place], surface: Surface, content: _Content, theme: Theme, axes: Floats
) -> tuple[tuple[Item, ...], Floats]:
    """Return the items of each place, in a row from left to right, and the points that the camera must show."""
    used = surface.used_vertices
    radius = TUBE_RADIUS * float(np.linalg.norm(np.ptp(surface.vertices[used] / surface.scale, axis=0))) or 1.0
    widths = [np.ptp(place.points[used] @ axes[0]) for place in places]
    items: list[Item] = []
    shown = []
    edge = 0.0
    for place, width in zip(places, widths, strict=True):
        points = place.points[used]
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        left = float((points @ axes[0]).min() - middle @ axes[0])
        shift = (edge - left) * axes[0] - middle
        edge += float(width) + GAP * float(max(widths))
        items += _items(place, surface, content, theme, shift, radius)
        shown.append(points + shift)
    return tuple(items), np.concatenate(shown)


def _items(
    place: _Place, surface: Surface, content: _Content, theme: Theme, shift: Floats, radius: float
) -> list[Item]:
    moved = place.points + shift
    mesh = SceneMesh(moved, surface.faces, colour=place.colour, field=content.field)
    items: list[Item] = [mesh]
    if place.path is not None:
        items.append(Tube(_lifted(place.path + shift, mesh, _LIFT * radius), radius, theme.path))
    for vertex, colour in content.marked:
        x, y, z = moved[vertex].tolist()
        items.append(Sphere((x, y, z), _MARKER * radius, colour))
    return items


def _lifted(path: Floats, mesh: SceneMesh, height: float) -> Floats:
    """Return a path on a mesh, moved along the normals of the vertices nearest to it."""
    normals = np.zeros_like(mesh.vertices)
    corners = mesh.vertices[mesh.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], flat)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.divide(normals, size, out=np.zeros_like(normals), where=size > 0)
    return np.asarray(path + height * carry(mesh.vertices, mesh.faces, path, unit))
