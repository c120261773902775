"""`render_scene`: from a scene and a camera to pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Ints, Singles
from unbend.errors import ParameterError
from unbend.jit import kernel
from unbend.render.colours import STEPS, Theme, colour_table, to_linear
from unbend.render.compose import compose, srgb_bytes
from unbend.render.normals import corner_normals
from unbend.render.occlusion import REACH, darken, places_around, smooth
from unbend.render.raster import BAND, SAMPLES, draw_bands, project, sort_into_bands
from unbend.render.scene import Item, Scene, SceneMesh, Sphere, Tube
from unbend.render.tubes import ball_mesh, joined, tube_mesh
from unbend.render.view import Camera, Size
from unbend.threads import check_threads, share_out

SMALLEST: Final = 16
"""Least width and height of a picture, in pixels."""

LARGEST: Final = 2048
"""Largest width and height of a picture, in pixels."""

CONTOUR_WIDTH: Final = 0.0045
"""Width of a contour seen from above, as a share of the picture's shorter side."""

_FINEST: Final = 1.4  # pixels, the least width of a contour


def render_scene(
    scene: Scene, camera: Camera, size: Size, theme: Theme, *, threads: int | None = None
) -> NDArray[np.uint8]:
    """Draw a scene with lights that move with the camera.

    Each pixel is the mean of 3 x 3 samples. A face with a corner behind the eye is not drawn.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    size : (int, int)
        Width and height in pixels, 16 to 2048 each.
    theme : Theme
        Its colours of the background, of contours and of unknown values are used.
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    (h, w, 4) uint8
        Red, green, blue in sRGB, not multiplied by alpha, and alpha, which is 255 everywhere unless the theme is
        transparent. The same for the same input, on every run.

    Raises
    ------
    ParameterError
        If a size or `threads` is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> from unbend.render.colours import THEMES
    >>> from unbend.render.scene import Scene, Sphere
    >>> from unbend.render.view import Camera
    >>> scene = Scene((Sphere((0.0, 0.0, 0.0), 1.0, (0.2, 0.4, 0.8)),))
    >>> pixels = render_scene(scene, Camera(np.eye(3), np.zeros(3), 3.0), (64, 48), THEMES["transparent"])
    >>> pixels.shape, int(pixels[24, 32, 3]), int(pixels[0, 0, 3])
    ((48, 64, 4), 255, 0)
    """
    check_size(size)
    check_threads(threads)
    picture, light = _drawn(scene, camera, size, theme, threads)
    pixels = np.empty(picture.shape, np.uint8)
    background, codes = to_linear(np.array(theme.background or (0.0, 0.0, 0.0))), srgb_bytes()
    transparent = theme.background is None

    def compose_rows(part: slice) -> None:
        compose(part.start, part.stop, picture, light, background, transparent, codes, pixels)

    share_out(len(pixels), threads, compose_rows)
    return pixels


def check_size(size: Size) -> None:
    """Raise ParameterError unless width and height are whole numbers from 16 to 2048."""
    for name, value in zip(("width", "height"), size, strict=True):
        if not _is_whole(value) or not SMALLEST <= value <= LARGEST:
            raise ParameterError(f"{name} must be a whole number from {SMALLEST} to {LARGEST}, not {value!r}")


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


@dataclass(frozen=True, eq=False)
class _Triangles:
    """All triangles of a scene in the arrays that the kernels take."""

    vertices: Floats  # (n, 3)
    faces: Ints  # (m, 3)
    normals: Singles  # (m, 3, 3)
    item_of: Ints  # (m,)
    colours: Singles  # (n, 3) linear
    values: Floats  # (n,)
    slopes: Floats  # (m,) of values along the surface
    tables: Singles  # (items, 256, 3) linear
    bounds: Floats  # (items, 2)
    steps: Ints  # (items,), -1 without a field


def _drawn(scene: Scene, camera: Camera, size: Size, theme: Theme, threads: int | None) -> tuple[Singles, Singles]:
    """Return linear light times coverage, and the coverage, (h, w, 4); and the share of light from around, (h, w)."""
    width, height = size
    picture = np.zeros((height, width, 4), np.float32)
    if not scene.items:
        return picture, np.ones((height, width), np.float32)
    triangles = _triangles(scene, threads)
    per_length = min(size) / camera.span
    seen = np.empty((len(triangles.vertices), 4))
    with np.errstate(all="ignore"):
        project(
            triangles.vertices, camera.axes, camera.centre, per_length * SAMPLES, 1 / camera.distance,
            float(width * SAMPLES), float(height * SAMPLES), seen,
        )  # fmt: skip
    bands = -(-height // BAND)
    starts, order = sort_into_bands(seen, triangles.faces, float(width * SAMPLES), bands)
    depth = np.full((height, width), -np.inf, np.float32)
    unknown, ink = (to_linear(np.array(each)) for each in (theme.unknown, theme.contour))
    half = max(CONTOUR_WIDTH, _FINEST / min(size)) * camera.span / 2

    def draw(part: slice) -> None:
        draw_bands(
            part.start, part.stop, seen, triangles.faces, triangles.normals, camera.axes, starts, order,
            triangles.item_of, triangles.colours, triangles.values, triangles.slopes, triangles.tables,
            triangles.bounds, triangles.steps, unknown, ink, half, picture, depth,
        )  # fmt: skip

    share_out(bands, threads, draw)
    return picture, _light_from_around(depth, picture[..., 3], per_length, REACH * min(size), threads)


def _light_from_around(
    depth: Singles, coverage: Singles, per_length: float, reach: float, threads: int | None
) -> Singles:
    rough, smoothed = np.empty_like(depth), np.empty_like(depth)
    places, lengths = places_around(reach)

    def darken_rows(part: slice) -> None:
        darken(part.start, part.stop, depth, coverage, per_length, reach, places, lengths, rough)

    def smooth_rows(part: slice) -> None:
        smooth(part.start, part.stop, depth, coverage, per_length, rough, smoothed)

    share_out(len(depth), threads, darken_rows)
    share_out(len(depth), threads, smooth_rows)
    return smoothed


def _triangles(scene: Scene, threads: int | None) -> _Triangles:
    meshes = [_as_mesh(item) for item in scene.items]
    vertices, faces = joined([(mesh.vertices, mesh.faces) for mesh in meshes])
    sizes = [len(mesh.faces) for mesh in meshes]
    tables = np.zeros((len(meshes), STEPS, 3), np.float32)
    bounds, steps = np.zeros((len(meshes), 2)), np.full(len(meshes), -1, np.int32)
    slopes = np.zeros(len(faces))
    stops = np.cumsum(sizes)
    for number, (mesh, stop) in enumerate(zip(meshes, stops, strict=True)):
        if mesh.field is not None:
            tables[number] = to_linear(colour_table(mesh.field.colour_map))
            bounds[number], steps[number] = mesh.field.bounds, mesh.field.contours
            if mesh.field.contours:
                _fill_slopes(mesh.vertices, mesh.faces, mesh.field.values, slopes[stop - len(mesh.faces) : stop])
    return _Triangles(
        vertices=np.ascontiguousarray(vertices),
        faces=faces,
        normals=np.concatenate([corner_normals(mesh.vertices, mesh.faces, threads) for mesh in meshes]),
        item_of=np.repeat(np.arange(len(meshes), dtype=np.int32), sizes),
        colours=np.concatenate([_vertex_colours(mesh) for mesh in meshes]),
        values=np.concatenate(
            [np.zeros(len(mesh.vertices)) if mesh.field is None else mesh.field.values for mesh in meshes]
        ),
        slopes=slopes,
        tables=tables,
        bounds=bounds,
        steps=steps,
    )


def _as_mesh(item: Item) -> SceneMesh:
    match item:
        case Tube():
            return SceneMesh(*tube_mesh(item.points, item.radius), item.colour)
        case Sphere():
            return SceneMesh(*ball_mesh(np.array(item.centre), item.radius), item.colour)
        case _:
            return item


def _vertex_colours(mesh: SceneMesh) -> Singles:
    if mesh.colours is not None:
        return to_linear(mesh.colours).astype(np.float32)
    whole = to_linear(np.array(mesh.colour)).astype(np.float32)
    return np.asarray(np.broadcast_to(whole, (len(mesh.vertices), 3)), np.float32)


@kernel
def _fill_slopes(vertices: Any, faces: Any, values: Any, slopes: Any) -> None:
    """Fill the slope of the values along each face: the length of their gradient; 0 where it has none."""
    for face in range(len(faces)):
        a, b, c = faces[face]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
        p, q = values[b] - values[a], values[c] - values[a]
        whole = uu * vv - uv * uv
        square = (p * p * vv - 2 * p * q * uv + q * q * uu) / whole if whole > 0 else 0.0
        slopes[face] = np.sqrt(square) if square > 0 and np.isfinite(square) else 0.0
