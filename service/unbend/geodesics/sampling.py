"""Farthest point sampling (Eldar et al. 1997), with fronts that stop where they cannot improve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.errors import ParameterError
from unbend.geodesics.distances import check_vertices
from unbend.geodesics.heap import heap_arrays
from unbend.geodesics.marching import march
from unbend.geodesics.stencils import Stencils, build_stencils
from unbend.jit import kernel
from unbend.mesh.surface import Surface


@dataclass(frozen=True, eq=False)
class Sampling:
    """Samples and the geodesic Voronoi diagram they make."""

    samples: Indices  # (k,)
    nearest: Ints  # (n,) place in `samples` of the nearest one; -1 where none can be reached
    radius: float
    """Largest distance from a reachable vertex to its nearest sample."""


def farthest_point_sampling(surface: Surface, count: int, *, start: int | None = None) -> Indices:
    """Choose `count` vertices, each the farthest from those before it.

    Parameters
    ----------
    surface : Surface
    count : int
        At least 1, at most the number of vertices that faces use.
    start : int, optional
        The first sample. By default an end of the surface: the vertex farthest from the one that is farthest
        from the first vertex used. Unlike a random start it is the same on every run and, nearly, in every pose.

    Returns
    -------
    (count,) int64
        Vertex indices, in the order they were chosen. Once every vertex that can be reached is taken, others
        follow in the order of their indices.

    Raises
    ------
    ParameterError
        If `count` or `start` is out of range.
    """
    return sample_farthest(surface, build_stencils(surface), count, start=start).samples


def sample_farthest(surface: Surface, stencils: Stencils, count: int, *, start: int | None = None) -> Sampling:
    """Return the sampling of `farthest_point_sampling` from stencils already built, with its Voronoi cells."""
    used = surface.used_vertices
    if not 1 <= count <= len(used):
        raise ParameterError(f"count must be between 1 and {len(used)}, the vertices that faces use, not {count}")
    vertex_at = np.argsort(stencils.place)
    usable = np.zeros(len(vertex_at), bool)
    usable[stencils.place[used]] = True
    first = stencils.place[used[0] if start is None else check_vertices(surface, start, "start")[0]]
    samples, owner, distance = _sample(stencils.offsets, stencils.entries, usable, first, start is None, count)
    nearest = owner[stencils.place]
    radius = distance[np.isfinite(distance)].max(initial=0.0)
    return Sampling(vertex_at[samples].astype(np.int64), nearest, float(radius))


@kernel
def _farthest(distance, usable):
    best = -1
    for vertex in range(len(distance)):
        if usable[vertex] and (best < 0 or distance[vertex] > distance[best]):
            best = vertex
    return best


@kernel
def _sample_from(offsets, entries, usable, first, count, distance, owner, keys, items, position):
    samples = np.empty(count, np.int32)
    free = usable.copy()
    vertex = first
    for number in range(count):
        samples[number] = vertex
        free[vertex] = False
        march(offsets, entries, vertex, True, distance, owner, number, keys, items, position)
        vertex = _farthest(distance, free)
    return samples


def _sample(
    offsets: Indices, entries: Floats, usable: Floats, first: int, seek_end: bool, count: int
) -> tuple[Ints, Ints, Floats]:
    size = len(usable)
    arrays = np.empty(size), np.empty(size, np.int32), *heap_arrays(size)
    sweeps = [1, 1, count] if seek_end else [count]
    for wanted in sweeps:
        arrays[0][:], arrays[1][:] = np.inf, -1
        samples = _sample_from(offsets, entries, usable, first, wanted, *arrays)
        first = _farthest_reached(arrays[0])
    return samples, arrays[1], arrays[0]


def _farthest_reached(distance: Floats) -> int:
    return int(np.where(np.isfinite(distance), distance, -1.0).argmax())
