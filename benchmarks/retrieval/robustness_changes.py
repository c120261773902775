"""Disturbances of a query's mesh; each file has its own random seed, which is the same in every run."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from unbend import MeshPolicy, Surface, compute_signature, geodesic_distances, read_mesh
from unbend.errors import MeshError
from unbend.mesh.repair import repair

Arrays = tuple[np.ndarray, np.ndarray]
Change = Callable[[Surface, np.random.Generator], Arrays]


def nothing(surface: Surface, _generator: np.random.Generator) -> Arrays:
    return surface.vertices, surface.faces


def moved(surface: Surface, generator: np.random.Generator) -> Arrays:
    """Rotate, mirror, rescale by a factor from 0.2 to 4, and reorder the vertices and faces."""
    turn = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    turn[0] *= -np.sign(np.linalg.det(turn))
    factor = np.exp(generator.uniform(np.log(0.2), np.log(4)))
    order = generator.permutation(len(surface.vertices))
    faces = np.argsort(order)[surface.faces]
    return factor * (surface.vertices @ turn.T)[order], generator.permutation(faces)


def subdivided(surface: Surface, _generator: np.random.Generator) -> Arrays:
    """Split each triangle in four at the midpoints of its edges."""
    pairs = np.sort(surface.faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)
    ends, numbers = np.unique(pairs, axis=0, return_inverse=True)
    middles = surface.vertices[ends].mean(axis=1)
    a, b, c = surface.faces.T
    p, q, r = len(surface.vertices) + numbers.reshape(-1, 3).T  # opposite a, b and c
    faces = np.concatenate([np.stack(corners, axis=1) for corners in ((a, r, q), (b, p, r), (c, q, p), (p, q, r))])
    return np.concatenate([surface.vertices, middles]), faces


def noisy(surface: Surface, generator: np.random.Generator, share: float) -> Arrays:
    """Add Gaussian noise to each coordinate; its standard deviation is a share of the bounding box's diagonal."""
    deviation = share * np.linalg.norm(np.ptp(surface.vertices[surface.used_vertices], axis=0))
    return surface.vertices + deviation * generator.normal(size=surface.vertices.shape), surface.faces


def noisy_by_edges(surface: Surface, generator: np.random.Generator, share: float) -> Arrays:
    """Add Gaussian noise to each coordinate; its standard deviation is a share of the median edge length."""
    corners = surface.vertices[surface.faces]
    deviation = share * np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2))
    return surface.vertices + deviation * generator.normal(size=surface.vertices.shape), surface.faces


def holed(surface: Surface, generator: np.random.Generator, share: float) -> Arrays:
    """Cut five holes: around each of five random vertices, remove the geodesically nearest share of all faces."""
    count = max(1, round(share * len(surface.faces)))
    kept = np.ones(len(surface.faces), bool)
    for distances in geodesic_distances(surface, generator.choice(surface.used_vertices, 5, replace=False)):
        kept[np.argsort(distances[surface.faces].sum(axis=1), kind="stable")[:count]] = False
    return surface.vertices, surface.faces[kept]


@dataclass(frozen=True)
class Disturbance:
    """A change of a mesh, and the options of reading the changed mesh."""

    change: Change
    smooth: int = 0
    denser: int | None = None
    """Limit of the number of vertices, as a multiple of the original number."""

    def read(self, path: Path) -> Surface:
        """Return the surface of the changed mesh, repaired like the mesh of a file."""
        surface = read_mesh(path)
        changed = self.change(surface, np.random.default_rng(zlib.crc32(path.name.encode())))
        most = None if self.denser is None else self.denser * len(surface.used_vertices)
        return repair(*changed, policy=MeshPolicy(max_vertices=most, smooth=self.smooth))


NOTHING = "none"
DISTURBANCES: Mapping[str, Disturbance] = {
    NOTHING: Disturbance(nothing),
    "rotated, mirrored, rescaled by 0.2 to 4, renumbered": Disturbance(moved),
    "three times the vertices": Disturbance(subdivided, denser=3),
    "noise 0.3 %": Disturbance(partial(noisy, share=0.003)),
    "noise 0.3 %, smooth=30": Disturbance(partial(noisy, share=0.003), smooth=30),
    "noise 1 %": Disturbance(partial(noisy, share=0.01)),
    "noise 1 %, smooth=1": Disturbance(partial(noisy, share=0.01), smooth=1),
    "noise 1 %, smooth=30": Disturbance(partial(noisy, share=0.01), smooth=30),
    "five holes of 0.2 % of the faces": Disturbance(partial(holed, share=0.002)),
    "five holes of 1 % of the faces": Disturbance(partial(holed, share=0.01)),
}

NOISE: Mapping[str, Change] = {
    "none": nothing,
    "0.1 edges": partial(noisy_by_edges, share=0.1),
    "0.2 edges": partial(noisy_by_edges, share=0.2),
    "0.3 edges": partial(noisy_by_edges, share=0.3),
    "0.3 % of the diagonal": partial(noisy, share=0.003),
    "1 % of the diagonal": partial(noisy, share=0.01),
}


def described(job: tuple[str, Path]) -> dict[str, Any]:
    """Return the descriptors of a mesh after the named disturbance."""
    name, path = job
    return dict(compute_signature(DISTURBANCES[name].read(path), threads=1).descriptors)


def roughnesses(path: Path) -> list[float]:
    """Return a mesh's roughness with each noise, or an empty list if the mesh cannot be read."""
    try:
        surface = read_mesh(path)
    except MeshError:
        return []
    found = []
    for change in NOISE.values():
        generator = np.random.default_rng(zlib.crc32(path.name.encode()))
        found.append(repair(*change(surface, generator)).report.roughness)
    return found
