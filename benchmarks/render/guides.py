"""The pictures of the guides: matches of points, and parts of shapes. All shapes are the demo's figures.

    python -m benchmarks.render.guides [NAME ...]

Writes docs/pictures/match-*.webp for docs/correspondence.md, and docs/pictures/part-*.webp for docs/partial.md.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from PIL import Image

from benchmarks.common import ROOT
from unbend import Surface, geodesic_distances, match, symmetry
from unbend.arrays import Bools, Floats
from unbend.correspondence.correspondence import Correspondence
from unbend.correspondence.export import place_colours
from unbend.correspondence.transfer import transfer
from unbend.local.key_points import key_points
from unbend.local.signatures import local_signatures
from unbend.mesh.shapes import figure
from unbend.render.colours import THEMES
from unbend.render.draw import render_scene
from unbend.render.scene import Field, Scene, SceneMesh, Sphere
from unbend.render.view import fit_camera, view_axes

PICTURES: Final = ROOT / "docs" / "pictures"
CELL, HEIGHT = 420, 400
GAP, MARGIN = 30, 24
THEME: Final = THEMES["transparent"]
RESOLUTION: Final = 4000
GREY: Final = np.array([0.78, 0.78, 0.78])
BALL: Final = 0.035
"""Radius of a mark, over the square root of the area."""
MARKS: Final = (
    (0.86, 0.2, 0.16),
    (0.13, 0.4, 0.83),
    (0.95, 0.66, 0.1),
    (0.17, 0.6, 0.3),
    (0.55, 0.25, 0.7),
    (0.1, 0.65, 0.7),
)


def main() -> None:
    for name in sys.argv[1:] or DRAWINGS:
        DRAWINGS[name]()


def match_colours() -> None:
    """Draw two kinds of body in two poses each; the first of each pair has the colours of the second."""
    meshes = []
    for kind, poses in (("biped", (2, 0)), ("quadruped", (3, 0))):
        first, second = (figure(kind, pose, resolution=RESOLUTION) for pose in poses)
        colours = place_colours(second)
        meshes += [coloured(second, colours), coloured(first, carried(match(first, second), colours))]
    save("match-colours", [drawn(mesh, azimuth=30.0) for mesh in meshes])


def match_landmarks() -> None:
    """Draw six places marked on a hand, and found on two other poses."""
    first = figure("hand", 0, resolution=RESOLUTION)
    marked = far_points(first, len(MARKS))
    cells = [drawn(plain(first), spheres(first, first.vertices[marked]), azimuth=30.0)]
    for pose in (2, 3):
        other = figure("hand", pose, resolution=RESOLUTION)
        places = transfer(match(first, other), other.vertices)[marked]
        cells.append(drawn(plain(other), spheres(other, places), azimuth=30.0))
    save("match-landmarks", cells)


def match_mirror() -> None:
    """Draw distances from a foot and its mirror image: equal on the left and on the right."""
    cells = []
    for kind, pose in (("biped", 2), ("quadruped", 3)):
        body = figure(kind, pose, resolution=RESOLUTION)
        mirror = symmetry(body)
        source = far_points(body, 1)
        both = np.array([source[0], mirror.vertices[source[0]]])
        along = geodesic_distances(body, both).min(axis=0)
        field = Field(along.max() - along, contours=12)
        mesh = SceneMesh(body.vertices, body.faces, field=field)
        cells.append(drawn(mesh, spheres(body, body.vertices[both]), azimuth=30.0))
    save("match-mirror", cells)


def part_place() -> None:
    """Draw a piece of one pose, and the same part of another pose; what the piece does not cover is grey."""
    cells = []
    for kind, poses, share in (("quadruped", (3, 0), 0.45), ("hand", (2, 0), 0.45)):
        bent, rest = (figure(kind, pose, resolution=RESOLUTION) for pose in poses)
        kept = disc(bent, far_points(bent, 1)[0], share)
        colours = carried(match(bent, rest), place_colours(rest))
        cells.append(drawn(coloured(Surface(bent.vertices, bent.faces[kept]), colours), azimuth=30.0))
        inside = np.zeros(len(bent.vertices))
        inside[bent.faces[kept]] = 1.0
        covered = transfer(match(rest, bent), inside) > 0.5
        cells.append(drawn(coloured(rest, np.where(covered[:, None], place_colours(rest), GREY)), azimuth=30.0))
    save("part-place", cells)


def part_circles() -> None:
    """Draw geodesic circles around the key points of a body in three poses."""
    cells = []
    for pose in (0, 2, 4):
        body = figure("biped", pose, resolution=RESOLUTION)
        local = local_signatures(body)
        places = local.places[key_points(local, 4)].astype(np.float64)
        points = np.array([int(((body.vertices - place) ** 2).sum(axis=1).argmin()) for place in places])
        along = geodesic_distances(body, points).min(axis=0)
        radius = 0.28 * float(np.sqrt(body.area))
        mesh = SceneMesh(
            body.vertices, body.faces,
            field=Field(np.where(along <= radius, radius - along, np.inf), low=0.0, high=radius, contours=5),
        )  # fmt: skip
        cells.append(drawn(mesh, spheres(body, body.vertices[points]), azimuth=30.0))
    save("part-circles", cells)


DRAWINGS: Final[dict[str, Callable[[], None]]] = {
    "match-colours": match_colours,
    "match-landmarks": match_landmarks,
    "match-mirror": match_mirror,
    "part-place": part_place,
    "part-circles": part_circles,
}


def carried(found: Correspondence, colours: Floats) -> Floats:
    values = transfer(found, colours)
    return np.where(np.isfinite(values), np.clip(values, 0.0, 1.0), GREY)


def disc(surface: Surface, centre: int, share: float) -> Bools:
    """Return a mask of the faces nearest to a vertex, with this share of the area."""
    order = np.argsort(geodesic_distances(surface, [centre])[0][surface.faces].mean(axis=1), kind="stable")
    area = np.cumsum(surface.face_areas[order])
    kept = np.zeros(len(order), bool)
    kept[order[: np.searchsorted(area, share * area[-1])]] = True
    return kept


def far_points(surface: Surface, count: int) -> np.ndarray:
    """Return the first vertices of a sampling that begins far from the middle: ends of limbs."""
    found = [int(geodesic_distances(surface, [0])[0].argmax())]
    while len(found) < count:
        found.append(int(geodesic_distances(surface, found).min(axis=0).argmax()))
    return np.array(found)


def plain(surface: Surface) -> SceneMesh:
    return SceneMesh(surface.vertices, surface.faces, colour=(0.68, 0.73, 0.8))


def coloured(surface: Surface, colours: Floats) -> SceneMesh:
    return SceneMesh(surface.vertices, surface.faces, colours=0.1 + 0.85 * colours)


def spheres(surface: Surface, places: Floats) -> list[Sphere]:
    radius = BALL * float(np.sqrt(surface.area))
    return [
        Sphere((float(x), float(y), float(z)), radius, colour) for (x, y, z), colour in zip(places, MARKS, strict=False)
    ]


def drawn(mesh: SceneMesh, marks: Sequence[Sphere] = (), *, azimuth: float) -> Image.Image:
    """Return a picture of a mesh, cropped to what it shows."""
    used = mesh.vertices[np.unique(mesh.faces)]
    camera = fit_camera(used, view_axes(azimuth, 14.0, "z"), (CELL, HEIGHT))
    scene = Scene((mesh, *marks))
    picture = Image.fromarray(render_scene(scene, camera, (CELL, HEIGHT), THEME))
    return picture.crop(picture.getbbox())


def save(name: str, cells: Sequence[Image.Image]) -> None:
    """Write pictures side by side, on white."""
    height = max(cell.height for cell in cells)
    width = sum(cell.width for cell in cells) + GAP * (len(cells) - 1)
    page = Image.new("RGBA", (width + 2 * MARGIN, height + 2 * MARGIN), "white")
    left = MARGIN
    for cell in cells:
        page.alpha_composite(cell, (left, MARGIN + (height - cell.height) // 2))
        left += cell.width + GAP
    path = PICTURES / f"{name}.webp"
    page.convert("RGB").save(path, quality=88, method=6)
    print(f"{path.name} {path.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
