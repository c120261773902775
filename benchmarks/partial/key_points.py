"""How often key points of one pose are key points of another, by several measures of FAUST and TOSCA.

python -m benchmarks.partial.key_points        # writes the section "key-points" of docs/benchmarks/pieces.md
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Final

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import eigsh

from benchmarks.common import BENCHMARKS, DATA, table, write_section
from benchmarks.correspondence.data import Subject, subject
from unbend import Surface
from unbend.arrays import Bools, Floats, Indices
from unbend.local.key_points import SCALE, curvature, key_points
from unbend.local.signatures import LocalSignatures, local_signatures

FOLDERS: Final = MappingProxyType({"TOSCA": "tosca5k", "FAUST": "faust5k"})

POSES: Final = 2
"""Poses of each object, the first by name."""

CENTRES: Final = 1500
"""More than usual, so that the spacing of the centres is much less than `NEAR`."""

COUNT: Final = 5
"""Key points of a mesh."""

NEAR: Final = 0.06
"""Geodesic distance within which points are the same, over the square root of the area."""

FREQUENCIES: Final = 80


@dataclass(frozen=True, eq=False)
class Pose:
    """A mesh with its local signatures."""

    subject: Subject
    local: LocalSignatures
    centres: Indices
    """The vertex of each centre, or the nearest one."""


@cache
def pose(folder: str, name: str) -> Pose:
    found = subject(folder, name)
    local = local_signatures(found.surface, centres=CENTRES, threads=1)
    centres = [int(np.linalg.norm(found.surface.vertices - place, axis=1).argmin()) for place in local.places]
    return Pose(found, local, np.array(centres))


def by_curvature(each: Pose) -> Indices:
    return key_points(each.local, COUNT)


def by_mean_distance(each: Pose) -> Indices:
    return _maxima(each, each.local.distances.mean(axis=1))


@cache
def by_heat(each: Pose) -> Indices:
    return _maxima(each, _heat_kernel(each.subject.surface)[each.centres])


def by_small_discs(each: Pose) -> Indices:
    return _maxima(each, curvature(each.local))


MEASURES: Final[Mapping[str, Callable[[Pose], Indices]]] = MappingProxyType(
    {
        "extrema of Gaussian curvature at a scale (`key_points`)": by_curvature,
        "maxima of the mean geodesic distance": by_mean_distance,
        "maxima of the heat kernel": by_heat,
        "minima of the area of a small disc": by_small_discs,
    }
)


def shares(points: Callable[[Pose], Indices], a: Pose, b: Pose) -> tuple[float, float]:
    """Return the share of the key points of `a` that are near one of `b`, and that of all points of `b`."""
    near = NEAR * np.sqrt(b.local.area)
    to_nearest = b.local.distances[points(b)].min(axis=0)
    images = [_image(a, b, centre) for centre in points(a)]
    return float((to_nearest[images] <= near).mean()), float((to_nearest <= near).mean())


def _image(a: Pose, b: Pose, centre: int) -> int:
    """Return the centre of `b` that is nearest to the true image of a centre of `a`."""
    at = a.subject.surface.vertices[a.subject.points]
    point = int(np.linalg.norm(at - a.local.places[centre], axis=1).argmin())
    image = b.subject.surface.vertices[b.subject.points[point]]
    return int(np.linalg.norm(b.local.places - image, axis=1).argmin())


def _maxima(each: Pose, values: Floats) -> Indices:
    """Return the centres whose value is the largest among all centres nearer than `SCALE`, as `key_points` does."""
    near: Bools = each.local.distances < SCALE * np.sqrt(each.local.area)
    highest = np.flatnonzero(values >= np.where(near, values, -np.inf).max(axis=1))
    return np.asarray(highest[np.argsort(-values[highest], kind="stable")][:COUNT])


def _heat_kernel(surface: Surface) -> Floats:
    """Return the heat that remains at each vertex after the time in which it spreads over a circle of radius `SCALE`.

    The cotangent Laplacian of Pinkall & Polthier (1993), and its lowest frequencies.
    """
    corners = surface.vertices[surface.faces]
    rows, columns, weights = [], [], []
    for corner in range(3):
        one, other = corners[:, corner - 2] - corners[:, corner], corners[:, corner - 1] - corners[:, corner]
        doubled = np.maximum(np.linalg.norm(np.cross(one, other), axis=1), 1e-12)
        rows.append(surface.faces[:, corner - 2])
        columns.append(surface.faces[:, corner - 1])
        weights.append((one * other).sum(axis=1) / (2 * doubled))
    size = len(surface.vertices)
    upper = coo_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size))
    both = (upper + upper.T).tocsr()
    mass = np.zeros(size)
    np.add.at(mass, surface.faces.ravel(), np.repeat(surface.face_areas / 3, 3))
    mass = np.maximum(mass, 1e-6 * surface.area)  # of vertices without a face
    stiffness = diags_array(np.asarray(both.sum(axis=1)).ravel()) - both
    values, vectors = eigsh(
        stiffness.tocsc(), FREQUENCIES, diags_array(mass).tocsc(), sigma=-1e-3 / surface.area, which="LM"
    )
    time = SCALE**2 / 4 * surface.area
    return np.asarray((np.exp(-np.maximum(values, 0) * time) * vectors**2).sum(axis=1))


def pairs(folder: str) -> list[tuple[Pose, Pose]]:
    """Return all ordered pairs of poses of the same object; in FAUST, the last digit is the pose."""
    objects: dict[str, list[str]] = {}
    for path in sorted((DATA / folder).glob("*.off")):
        kind = path.stem[:-1] if folder == "faust5k" else path.stem.rstrip("0123456789")
        objects.setdefault(kind, []).append(path.stem)
    chosen = [names[:POSES] for names in objects.values()]
    return [(pose(folder, a), pose(folder, b)) for names in chosen for a in names for b in names if a != b]


def main() -> None:
    rows = []
    for title, points in MEASURES.items():
        cells = []
        for folder in FOLDERS.values():
            again, by_chance = np.mean([shares(points, a, b) for a, b in pairs(folder)], axis=0)
            cells.append(f"{again:.2f} ({by_chance:.2f})")
        rows.append([title, *cells])
        print(rows[-1], flush=True)
    note = (
        f"The share of the {COUNT} key points of one pose that are within {NEAR} sqrt(area) of one\n"
        "of another pose of the same object, by the true correspondence; in brackets, that of all points.\n"
        f"Of {CENTRES} points on each mesh, each key point is extreme among those nearer than {SCALE}.\n"
    )
    text = table(["key points", *FOLDERS], rows)
    write_section(BENCHMARKS / "pieces.md", "key-points", f"{note}\n{text}")


if __name__ == "__main__":
    main()
