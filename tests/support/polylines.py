"""Distances of polylines from a surface, and lengths of locally shortest paths."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from unbend import Surface
from unbend.geodesics.paths.descent import descend
from unbend.geodesics.paths.straighten import path_length, shorten
from unbend.geodesics.paths.strips import StripMesh, path_arrays, work_arrays
from unbend.jit import kernel


def length(polyline: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(polyline, axis=0), axis=1).sum())


def distance_to_triangles(point: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return distances from a point (3,) to triangles (m, 3, 3), which may have zero area."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    best = np.minimum(_to_segments(point, a, b), np.minimum(_to_segments(point, b, c), _to_segments(point, c, a)))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    inside = size > 0
    for tail, head in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(head - tail, point - tail), normal) >= 0
    height = np.abs(np.einsum("ij,ij->i", point - a, normal)) / np.where(size > 0, size, 1)
    return np.where(inside, np.minimum(best, height), best)


def _to_segments(point: np.ndarray, tail: np.ndarray, head: np.ndarray) -> np.ndarray:
    along = head - tail
    squared = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", point - tail, along) / np.where(squared > 0, squared, 1)
    return np.linalg.norm(point - tail - np.clip(share, 0, 1)[:, None] * along, axis=1)


def distance_from_surface(surface: Surface, polyline: np.ndarray) -> float:
    """Return the largest distance of a polyline's segments from a surface; 0 if each is in one triangle.

    The distance of a segment from a triangle is that of its farther end. Only triangles whose bounding boxes contain
    the segment are considered; the result is inf if there are none.
    """
    corners = surface.vertices[surface.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    slack = 1e-9 * np.ptp(surface.vertices[surface.used_vertices], axis=0).max()
    worst = 0.0
    for ends in pairwise(polyline):
        near = ((np.minimum(*ends) >= low - slack) & (np.maximum(*ends) <= high + slack)).all(axis=1)
        if not near.any():
            return float("inf")
        worst = max(worst, np.maximum(*(distance_to_triangles(end, corners[near]) for end in ends)).min())
    return float(worst)


def path_lengths(mesh: StripMesh, field: np.ndarray, source: int, targets: np.ndarray) -> np.ndarray:
    """Return the lengths of locally shortest paths from a vertex to others, found by descent on its distance field.

    The field only decides on which side of each vertex the path passes, so the lengths are much more accurate than the
    field. The length of a path is never less than the geodesic distance. The length is inf where the field is inf. If
    a descent does not reach the source, or its path cannot be shortened, the length is the value of the field.
    """
    field, targets = np.array(field), np.asarray(targets, np.int64)
    order = np.argsort(field[targets], kind="stable")  # nearest first, so that later descents use the refined field
    lengths = np.empty(len(targets))
    lengths[order] = _refine(
        mesh, field, np.int64(source), targets[order], path_arrays(mesh), path_arrays(mesh), work_arrays(mesh)
    )
    return lengths


@kernel
def _refine(mesh, field, source, targets, path, spare, work):
    """Return the lengths of locally shortest paths from `source` to `targets`, and write them to `field`."""
    half_edges, offsets, corners, extent = mesh
    strip, points, ends, deque, turns = work
    scratch = strip, points, ends, deque
    here, there = (path.pieces, path.portals), (spare.pieces, spare.portals)
    lengths = np.empty(len(targets))
    for index in range(len(targets)):
        target = targets[index]
        lengths[index] = field[target]
        if target == source or not np.isfinite(field[target]):
            continue
        count = descend(half_edges, offsets, corners, field, 1.0 / extent, source, target, here[0], here[1])
        if count > 0:
            here, there, count = shorten(half_edges, offsets, here, count, there, turns, scratch)
        if count > 0:
            lengths[index] = field[target] = path_length(here[0], count) * extent
    return lengths
