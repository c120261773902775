"""Farthest point sampling (Eldar et al. 1997), with fronts that stop where an earlier sample is nearer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Bools, Indices, Ints
from unbend.errors import ParameterError
from unbend.geodesics.distances import check_vertices
from unbend.geodesics.fronts import spread
from unbend.geodesics.marching import UNREACHED, front_arrays
from unbend.geodesics.start import start_arrays
from unbend.geodesics.stencils import SLOTS, Stencils, stencils_of
from unbend.jit import kernel
from unbend.mesh.surface import Surface
from unbend.tolerances import SAMPLING_TIE

_AT_A_TIME: Final = 32
"""Samples between two progress reports: so many that the reports take no noticeable time."""

_TIE: Final = np.float32(1.0 - SAMPLING_TIE)


@dataclass(frozen=True, eq=False)
class Sampling:
    """Samples and their geodesic Voronoi diagram."""

    samples: Indices  # (k,)
    nearest: Ints  # (n,) index in `samples` of the nearest sample; -1 where none is reachable
    radius: float
    """Largest distance from a reachable vertex to its nearest sample."""


def farthest_point_sampling(surface: Surface, count: int, *, start: int | None = None) -> Indices:
    """Choose `count` vertices, each the farthest from all previous ones.

    Parameters
    ----------
    surface : Surface
    count : int
        At least 1, at most the number of vertices that faces use.
    start : int, optional
        The first sample. The default is an end of the surface: the vertex farthest from the one that is farthest from
        the first vertex used. Unlike a random start, it is the same on every run and nearly the same in every pose.

    Returns
    -------
    (count,) int64
        Vertex indices, in the order they were chosen. Vertices that no sample reaches, on other components, count as
        the farthest, the lowest index first.

    Raises
    ------
    ParameterError
        If `count` or `start` is out of range.

    Examples
    --------
    >>> from unbend.mesh.shapes import cylinder
    >>> surface = cylinder()
    >>> samples = farthest_point_sampling(surface, 10, start=0)
    >>> int(samples[0]), len(set(samples.tolist()))
    (0, 10)
    """
    return sample_farthest(surface, stencils_of(surface), count, start=start).samples


def sample_farthest(
    surface: Surface,
    stencils: Stencils,
    count: int,
    *,
    start: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Sampling:
    """Return the same samples as `farthest_point_sampling`, from existing stencils, and their Voronoi cells.

    `progress` receives the number of samples after every 32 samples and at the end of each search.
    """
    used = surface.used_vertices
    if not 1 <= count <= len(used):
        raise ParameterError(f"count must be between 1 and {len(used)}, the vertices that faces use, not {count}")
    vertex_at = np.full(stencils.vertex_count, -1)  # no vertex at Steiner points, which are never samples
    vertex_at[stencils.place] = np.arange(len(stencils.place))
    usable = np.zeros(len(vertex_at), bool)
    usable[stencils.place[used]] = True
    vertex = stencils.place[used[0] if start is None else check_vertices(surface, start, "start")[0]]
    wanted = [1, 1, count] if start is None else [count]
    for number in wanted:  # the vertex farthest from the samples starts the next search
        samples, owner, distance = _sample(stencils, usable, vertex_at, vertex, number, progress)
        vertex = int(np.where(usable & np.isfinite(distance), distance, -1.0).argmax())
    radius = float(distance[usable & np.isfinite(distance)].max(initial=0.0)) * stencils.unit
    return Sampling(vertex_at[samples].astype(np.int64), owner[stencils.place], radius)


def _sample(
    stencils: Stencils, usable: Bools, labels: Indices, first: int, count: int, progress: Callable[[int], None] | None
) -> tuple[Ints, Ints, NDArray[np.float32]]:
    """Return `count` samples from `first` on, each vertex's nearest sample, and its distance in median edges."""
    size = stencils.vertex_count
    distance, owner = np.full(size, UNREACHED), np.full(size, -1, np.int32)
    samples, free, vertex = np.empty(count, np.int32), usable.copy(), first
    reached, start, front = np.empty(size, np.int32), start_arrays(size), front_arrays(size)
    for begin in range(0, count, _AT_A_TIME):
        end = min(count, begin + _AT_A_TIME)
        vertex = _sample_on(
            stencils.arrays, free, labels, vertex, begin, end, samples, distance, owner, reached, SLOTS, start, front
        )
        if progress:
            progress(end)
    return samples, owner, distance


@kernel
def _sample_on(stencils, free, labels, vertex, begin, end, samples, distance, owner, reached, width, start, front):
    """Take samples number `begin` to `end` - 1, starting with `vertex`; return the next sample."""
    for number in range(begin, end):
        samples[number] = vertex
        free[vertex] = False
        spread(stencils, vertex, number, np.inf, distance, owner, reached, width, start, front)
        vertex = _farthest(distance, free, labels)
    return vertex


@kernel
def _farthest(distance, usable, labels):
    """Return the farthest vertex; among ties, the vertex with the lowest label.

    Distances that differ only by rounding are ties, so that bent versions of a symmetric mesh have the same samples.
    """
    largest = np.float32(-1.0)
    for vertex in range(len(distance)):
        if usable[vertex] and distance[vertex] > largest:
            largest = distance[vertex]
    enough, first = largest * _TIE, -1
    for vertex in range(len(distance)):
        if usable[vertex] and distance[vertex] >= enough and (first < 0 or labels[vertex] < labels[first]):
            first = vertex
    return first
