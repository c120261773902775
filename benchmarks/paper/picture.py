"""The picture of the README: three shapes in two poses each, and their signatures.

Colour and contours are the distance along the surface from one point, the same on each pose. The signature of the
first pose is turned to match its surface. The signature of the second pose is turned to match that of the first, by
corresponding points. Writes docs/pictures/signatures.png.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from benchmarks.common import DATA, ROOT
from unbend import CanonicalForm, Parameters, Surface, canonical_form, geodesic_distances, read_mesh
from unbend.render.colours import THEMES
from unbend.render.draw import render_scene
from unbend.render.picture import form_in_space
from unbend.render.scene import Field, Scene, SceneMesh
from unbend.render.view import fit_camera, view_axes
from unbend.signature.orientation import orient_form

FOLDER = DATA / "tosca5k"
CELL = 460
ROW = 400
GAP, APART, MARGIN = 26, 70, 30
CONTOURS = 13
THEME = THEMES["transparent"]


@dataclass(frozen=True)
class Shown:
    """Two poses of a shape, their view, and a direction: distances begin at the first pose's farthest point in it."""

    poses: tuple[str, str]
    azimuth: float
    far: tuple[float, float, float]


SHOWN = (
    Shown(("cat0", "cat3"), 40.0, (0.0, -1.0, 0.0)),
    Shown(("michael10", "michael9"), 20.0, (0.0, 0.0, 1.0)),
    Shown(("horse0", "horse10"), 40.0, (0.0, -1.0, 0.0)),
)


@dataclass(frozen=True)
class Pose:
    """A surface, its form, and its vertex at each point that all poses have in common."""

    surface: Surface
    form: CanonicalForm
    points: np.ndarray


def main() -> None:
    rows = [_columns(shown) for shown in SHOWN]
    pairs = [pair for columns in rows for pair in columns]
    widths = [max(above.width, below.width) for above, below in pairs]
    gaps = [APART if number % 2 else GAP for number in range(len(pairs) - 1)]
    size = 2 * MARGIN + sum(widths) + sum(gaps), 2 * MARGIN + 2 * ROW + GAP
    page = Image.new("RGBA", size, "white")
    lefts = np.cumsum([MARGIN, *(width + gap for width, gap in zip(widths, gaps, strict=False))])
    for (above, below), width, left in zip(pairs, widths, lefts.tolist(), strict=True):
        page.alpha_composite(above, (left + (width - above.width) // 2, MARGIN + ROW - above.height))
        middle = MARGIN + ROW + GAP + ROW // 2
        page.alpha_composite(below, (left + (width - below.width) // 2, middle - below.height // 2))
    page.convert("RGB").save(ROOT / "docs" / "pictures" / "signatures.png", optimize=True)


def _columns(shown: Shown) -> list[tuple[Image.Image, Image.Image]]:
    """Return the pictures of a surface and of its signature, for each pose."""
    first, second = (_pose(name) for name in shown.poses)
    start = form_in_space(first.form, first.surface)
    target = np.full((len(second.surface.vertices), 3), np.nan)
    target[second.points] = start[first.points]
    turned = orient_form(second.form.points * second.form.signature.scale, target)[:, :3]
    far = int((first.surface.vertices[first.points] @ shown.far).argmax())
    distances = [geodesic_distances(pose.surface, int(pose.points[far]))[0] for pose in (first, second)]
    most = max(float(along.max()) for along in distances)
    fields = [Field(most - along, low=0.0, high=most, contours=CONTOURS) for along in distances]
    faces = [first.surface.faces, second.surface.faces]
    above = _drawn([first.surface.vertices, second.surface.vertices], faces, fields, shown.azimuth)
    below = _drawn([start, turned], faces, fields, shown.azimuth)
    return list(zip(above, below, strict=True))


def _pose(name: str) -> Pose:
    surface = read_mesh(FOLDER / f"{name}.off")
    points = np.loadtxt(FOLDER / "corres" / f"{name}.vts", dtype=int) - 1
    return Pose(surface, canonical_form(surface, Parameters(samples=600)), points)


def _drawn(
    places: Sequence[np.ndarray], faces: Sequence[np.ndarray], fields: Sequence[Field], azimuth: float
) -> list[Image.Image]:
    """Return a picture for each array of vertex positions, all at one scale, cropped to what each shows."""
    axes = view_axes(azimuth, 12.0, "z")
    cameras = [fit_camera(points, axes, (CELL, ROW + 2 * MARGIN)) for points in places]
    span = max(camera.span for camera in cameras)
    pictures = []
    for points, triangles, field, camera in zip(places, faces, fields, cameras, strict=True):
        scene = Scene((SceneMesh(points, triangles, field=field),))
        picture = Image.fromarray(render_scene(scene, replace(camera, span=span), (CELL, ROW + 2 * MARGIN), THEME))
        pictures.append(picture.crop(picture.getbbox()))
    return pictures


if __name__ == "__main__":
    main()
