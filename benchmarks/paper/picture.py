"""The picture of the README: shapes in two poses each, and their signatures.

The colour of a point is its mean geodesic distance to the other points, on the surface and on the signature. A
signature is defined up to reflections, so the signature of the second pose is drawn in the reflection nearest to the
first. Writes docs/pictures/signatures.png.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import matplotlib as mpl
import numpy as np

from benchmarks.common import ROOT

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.colors import LightSource
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from scipy.spatial import cKDTree

from unbend import Parameters, Surface, compute_signature, geodesic_distances
from unbend.mesh.shapes import figure

SHOWN = [("biped", 3), ("biped", 11), ("quadruped", 1), ("quadruped", 8), ("hand", 4), ("hand", 9)]
LIGHT = LightSource(azdeg=300, altdeg=50)


def main() -> None:
    page = plt.figure(figsize=(15, 5.4))
    page.subplots_adjust(left=0, right=1, bottom=0, top=0.93, wspace=0, hspace=0.02)
    before = np.empty((0, 3))
    for column, (kind, pose) in enumerate(SHOWN):
        surface = figure(kind, pose)
        signature = compute_signature(surface, Parameters(samples=700))
        values = geodesic_distances(surface, signature.samples[:100]).mean(axis=0)
        points = signature.points if column % 2 == 0 else _nearest_reflection(signature.points, before)
        before = points
        top = page.add_subplot(2, len(SHOWN), 1 + column, projection="3d")
        _draw(top, surface, values, (14, -68))
        top.set_title(f"{kind}, pose {pose}", fontsize=12)
        below = page.add_subplot(2, len(SHOWN), 1 + len(SHOWN) + column, projection="3d")
        _draw(below, Surface(points[:, [1, 2, 0]], signature.faces), values[signature.samples], (10, -75))
    page.savefig(ROOT / "docs" / "pictures" / "signatures.png", dpi=90)


def _nearest_reflection(points: np.ndarray, other: np.ndarray) -> np.ndarray:
    tree = cKDTree(other)
    reflected = [points * signs for signs in product((1, -1), repeat=3)]
    return min(reflected, key=lambda candidate: float((tree.query(candidate)[0] ** 2).mean()))


def _draw(axes: Any, surface: Surface, values: np.ndarray, view: tuple[float, float]) -> None:
    points = surface.vertices
    triangles = points[surface.faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-300
    shade = 0.55 + 0.45 * np.abs(normals @ LIGHT.direction)
    colours = plt.get_cmap("viridis")((values[surface.faces].mean(axis=1) - values.min()) / np.ptp(values))
    colours[:, :3] *= shade[:, None]
    axes.add_collection3d(Poly3DCollection(triangles, facecolors=colours, edgecolors="none", antialiased=False))
    low, high = points.min(axis=0), points.max(axis=0)
    for name, start, stop in zip("xyz", low, high, strict=True):
        getattr(axes, f"set_{name}lim")(start, stop)
    axes.set_box_aspect(high - low, zoom=1.25)
    axes.set_axis_off()
    axes.view_init(*view)


if __name__ == "__main__":
    main()
