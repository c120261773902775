"""Pairs of FAUST and TOSCA with known correspondence: one half to choose constants, the other to report."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np

from benchmarks.common import DATA
from unbend import Surface, geodesic_distances, read_mesh
from unbend.arrays import Indices, Singles

Half = Literal["choice", "report"]
Dataset = Literal["FAUST, between persons", "TOSCA, within an object"]

DATASETS: Final[tuple[Dataset, ...]] = ("FAUST, between persons", "TOSCA, within an object")

_CHOSEN_ON: Final = ("cat", "david", "horse", "wolf")
"""Objects of TOSCA on which constants were chosen. Of FAUST, it is the meshes of even number."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A mesh, the vertex of each true point, and the vertex of its mirror image."""

    name: str
    surface: Surface
    points: Indices
    mirrored: Indices


@lru_cache(maxsize=64)
def subject(folder: str, name: str) -> Subject:
    surface = read_mesh(DATA / folder / f"{name}.off")

    def vertices(suffix: str) -> Indices:
        listed = np.loadtxt(DATA / folder / "corres" / f"{name}{suffix}.vts", dtype=np.int64) - 1
        return listed if surface.vertex_map is None else surface.vertex_map[listed]

    return Subject(name, surface, vertices(""), vertices(".sym"))


def pairs(dataset: Dataset, half: Half, count: int, seed: int = 0) -> list[tuple[Subject, Subject]]:
    """Return `count` random pairs of different meshes of a half."""
    folder = "faust5k" if dataset.startswith("FAUST") else "tosca5k"
    names = sorted(path.stem for path in (DATA / folder).glob("*.off"))
    if folder == "faust5k":
        chosen = [name for name in names if (int(name[-3:]) % 2 == 0) == (half == "choice")]
        listed = [(a, b) for a in chosen for b in chosen if a[:-1] != b[:-1]]  # the last digit is the pose
    else:
        kind = {name: name.rstrip("0123456789") for name in names}
        chosen = [name for name in names if (kind[name] in _CHOSEN_ON) == (half == "choice")]
        listed = [(a, b) for a in chosen for b in chosen if a != b and kind[a] == kind[b]]
    order = np.random.default_rng(seed).permutation(len(listed))[:count]
    return [(subject(folder, listed[place][0]), subject(folder, listed[place][1])) for place in order]


def same_person(half: Half, count: int, seed: int = 0) -> list[tuple[Subject, Subject]]:
    """Return `count` random pairs of different poses of one person of FAUST."""
    names = sorted(path.stem for path in (DATA / "faust5k").glob("*.off"))
    chosen = [name for name in names if (int(name[-3:]) % 2 == 0) == (half == "choice")]
    listed = [(a, b) for a in chosen for b in chosen if a != b and a[:-1] == b[:-1]]
    order = np.random.default_rng(seed).permutation(len(listed))[:count]
    return [(subject("faust5k", listed[place][0]), subject("faust5k", listed[place][1])) for place in order]


@lru_cache(maxsize=20)
def distances_to(b: Subject, every: int) -> tuple[Singles, Indices]:
    """Return the distances from the vertices of true points to all, and the row of each point."""
    sources, rows = np.unique(b.points[::every], return_inverse=True)
    return (geodesic_distances(b.surface, sources) / np.sqrt(b.surface.area)).astype(np.float32), rows


def errors(a: Subject, b: Subject, images: Indices, every: int = 1) -> tuple[Singles, Singles]:
    """Return the geodesic distance of each point's image from the truth, and from its mirror image, over sqrt(area).

    `images` has a vertex of b for each vertex of a; `every` takes only each so many points. The protocol of Kim, Lipman
    & Funkhouser 2011.
    """
    distances, rows = distances_to(b, every)
    return distances[rows, images[a.points[::every]]], distances[rows, images[a.mirrored[::every]]]


def floor(a: Subject, b: Subject) -> float:
    """Return the least mean error that a map between vertices can have: several points share a vertex of `a`."""
    distances, rows = distances_to(b, 1)
    total = 0.0
    for vertex in np.unique(a.points):
        here = np.flatnonzero(a.points == vertex)
        total += distances[np.ix_(rows[here], b.points[here])].sum(axis=1).min()
    return float(total / len(a.points))
