"""Contours of a function on a surface: the points where it has given values."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from unbend.arrays import Bools, Floats, Indices
from unbend.errors import ParameterError
from unbend.jit import kernel
from unbend.mesh.surface import Surface

Polylines = tuple[Floats, ...]


def iso_contours(surface: Surface, values: ArrayLike, levels: ArrayLike) -> tuple[Polylines, ...]:
    """Contours of a function given at the vertices and linear in each triangle, such as a field of distances.

    A contour separates the part of the surface below the level from the part at or above the level. So it has no gaps
    at vertices with exactly that value. It may run along edges there, but not inside a triangle whose values all equal
    the level. A single vertex at the level that is a local maximum or minimum has no contour. Along a crest of edges
    at the level, the contour runs back and forth.

    Parameters
    ----------
    surface : Surface
        Any triangulated surface. Contours end at edges of three faces or more.
    values : (n,) float
        One value per vertex. Triangles with an infinite value, such as those at unreachable vertices, have no contours.
    levels : float or (l,) float

    Returns
    -------
    tuple of l tuples of (p, 3) float64
        The polylines of each level; closed ones repeat their first point.

    Raises
    ------
    ParameterError
        If there is not one value for each vertex, a used vertex has NaN, or `levels` is not a finite number or a
        one-dimensional array of finite numbers.

    Examples
    --------
    >>> from unbend.mesh.shapes import sphere
    >>> surface = sphere()
    >>> [len(polylines) for polylines in iso_contours(surface, surface.vertices[:, 2], [0.5, 2.0])]
    [1, 0]
    """
    values, levels = np.asarray(values, np.float64), np.atleast_1d(np.asarray(levels, np.float64))
    if values.shape != (len(surface.vertices),):
        raise ParameterError(f"values must be ({len(surface.vertices)},), one for each vertex, not {values.shape}")
    if np.isnan(values[surface.used_vertices]).any():
        raise ParameterError("values: one of them is not a number")
    if levels.ndim != 1 or not np.isfinite(levels).all():
        raise ParameterError("levels must be a finite number or a one-dimensional array of finite numbers")
    lowest, highest = np.empty(len(surface.faces)), np.empty(len(surface.faces))
    _ranges(surface.faces, values, lowest, highest)
    return tuple(_polylines(surface, values, level, (lowest < level) & (level <= highest)) for level in levels)


@kernel
def _ranges(faces, values, lowest, highest):
    for face in range(len(faces)):
        a, b, c = values[faces[face, 0]], values[faces[face, 1]], values[faces[face, 2]]
        lowest[face], highest[face] = min(a, b, c), max(a, b, c)
        if not (np.isfinite(lowest[face]) and np.isfinite(highest[face])):
            lowest[face], highest[face] = np.inf, -np.inf


def _polylines(surface: Surface, values: Floats, level: float, crossed: Bools) -> Polylines:
    faces = surface.faces[crossed]
    if len(faces) == 0:
        return ()
    edges = np.sort(faces[:, [[1, 2], [2, 0], [0, 1]]], axis=2)  # (k, 3, 2)
    apart = (values[edges[..., 0]] < level) != (values[edges[..., 1]] < level)  # two edges of each crossed triangle
    apart[(faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])] = False
    keys = (edges[..., 0].astype(np.int64) * len(surface.vertices) + edges[..., 1])[apart]
    if len(keys) == 0:
        return ()
    keys, segments = np.unique(keys, return_inverse=True)
    points = _crossings(surface.vertices, values, level, keys)
    order, starts = _chain(segments.reshape(-1, 2).astype(np.int32), len(keys))
    lines = (without_repeats(points[order[start:stop]]) for start, stop in pairwise(starts))
    return tuple(line for line in lines if len(line) > 1)


def _crossings(vertices: Floats, values: Floats, level: float, keys: Indices) -> Floats:
    first, second = np.divmod(keys, len(vertices))
    share = ((level - values[first]) / (values[second] - values[first]))[:, None]
    between = vertices[first] + share * (
        vertices[second] - vertices[first]
    )  # a coordinate that both ends share stays exact
    return np.asarray(np.where(share < 1, between, vertices[second]), np.float64)


def without_repeats(points: Floats) -> Floats:
    """Drop consecutive repeats of a point, which occur where a line crosses several edges at their vertex."""
    keep: Bools = np.append(True, (points[1:] != points[:-1]).any(axis=1))
    return points[keep]


@kernel
def _links(segments, count):
    """Return for each point at most two of its segments, and the number of all its segments."""
    links, degree = np.full((count, 2), -1, np.int32), np.zeros(count, np.int32)
    for segment in range(len(segments)):
        for end in range(2):
            point = segments[segment, end]
            if degree[point] < 2:
                links[point, degree[point]] = segment
            degree[point] += 1
    return links, degree


@kernel
def _follow(segments, links, degree, used, segment, point, order, size):
    """Append the chain that begins at `point` with `segment`; return the new size of `order`."""
    order[size] = point
    size += 1
    while segment >= 0 and not used[segment]:
        used[segment] = True
        point = segments[segment, 1] if segments[segment, 0] == point else segments[segment, 0]
        order[size] = point
        size += 1
        if degree[point] != 2:
            break
        segment = links[point, 1] if links[point, 0] == segment else links[point, 0]
    return size


@kernel
def _chain(segments, count):
    """Join segments (k, 2) between `count` points into chains; return the points in order, and each chain's start.

    A chain ends at a point with one segment or more than two. Chains without such a point are closed.
    """
    links, degree = _links(segments, count)
    used = np.zeros(len(segments), np.bool_)
    order, starts = np.empty(2 * len(segments), np.int32), np.zeros(len(segments) + 1, np.int64)
    size = chains = 0
    for closed in range(2):
        for segment in range(len(segments)):
            for end in range(2):
                point = segments[segment, end]
                if not used[segment] and (closed or degree[point] != 2):
                    size = _follow(segments, links, degree, used, segment, point, order, size)
                    chains += 1
                    starts[chains] = size
    return order[:size], starts[: chains + 1]
