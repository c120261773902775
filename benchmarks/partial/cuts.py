"""Pieces of meshes with known origin, cut by seed: geodesic discs, halves by a plane, and surfaces with holes."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from unbend import Surface, geodesic_distances
from unbend.arrays import Bools, Floats
from unbend.mesh.components import largest_component

Cut = Callable[[Surface, np.random.Generator], Surface]


def disc(share: float) -> Cut:
    """Return a cut that keeps a geodesic disc of this share of the area around a random vertex."""

    def cut(surface: Surface, random: np.random.Generator) -> Surface:
        return _kept(surface, _lowest(surface, _distances(surface, random, 1), share))

    return cut


def half(surface: Surface, random: np.random.Generator) -> Surface:
    """Keep what is on one side of a plane in a random direction that halves the area."""
    return _kept(surface, _lowest(surface, surface.vertices @ random.normal(size=3), 0.5))


def holes(count: int, left: float) -> Cut:
    """Return a cut that removes discs around `count` random vertices, so that this share of the area is left."""

    def cut(surface: Surface, random: np.random.Generator) -> Surface:
        return _kept(surface, ~_lowest(surface, _distances(surface, random, count), 1 - left))

    return cut


CUTS: Final[Mapping[str, Cut]] = MappingProxyType(
    {
        "disc, .60 of the area": disc(0.6),
        "disc, .45": disc(0.45),
        "disc, .30": disc(0.3),
        "half, by a plane": half,
        "8 holes, .60 left": holes(8, 0.6),
    }
)


def piece(surface: Surface, cut: str, name: str) -> Surface:
    """Return the piece that `cut` makes of the mesh called `name`: the same on every run."""
    return CUTS[cut](surface, np.random.default_rng(zlib.crc32(f"{cut}/{name}".encode())))


def _distances(surface: Surface, random: np.random.Generator, count: int) -> Floats:
    sources = random.choice(surface.used_vertices, count, replace=False)
    return np.asarray(geodesic_distances(surface, sources, threads=1).min(axis=0))


def _lowest(surface: Surface, values: Floats, share: float) -> Bools:
    """Return a mask of the faces with the lowest values, with this share of the area."""
    order = np.argsort(values[surface.faces].mean(axis=1), kind="stable")
    area = np.cumsum(surface.face_areas[order])
    chosen = np.zeros(len(order), bool)
    chosen[order[: np.searchsorted(area, share * area[-1]) + 1]] = True
    return chosen


def _kept(surface: Surface, faces: Bools) -> Surface:
    largest, _, _ = largest_component(Surface(surface.vertices, surface.faces[faces]))
    used, corners = np.unique(largest, return_inverse=True)
    return Surface(surface.vertices[used], corners.reshape(-1, 3))
