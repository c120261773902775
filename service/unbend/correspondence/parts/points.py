"""From places of samples to a point on the triangles of the whole for each vertex of a piece."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.correspondence.parts.assignment import TURNING, assign
from unbend.correspondence.parts.directions import directions_of
from unbend.correspondence.parts.looks import vertex_looks
from unbend.correspondence.parts.pairs import pairs_of
from unbend.correspondence.parts.placing import turned
from unbend.correspondence.parts.views import View
from unbend.correspondence.projection import closest
from unbend.geodesics.distances import distance_rows
from unbend.geodesics.stencils import stencils_of
from unbend.jit import kernel

_SCALE: Final = 0.15
"""Distance at which a pair counts a third: near samples tell the place best."""

_MOVE: Final = 0.15
"""How far a point is sought from the image of its sample."""


@dataclass(frozen=True, eq=False)
class Points:
    """A point of the whole for each vertex of a piece."""

    images: Indices  # (S,) the vertex of the whole of each sample
    rows: Floats  # (S, n) distances from it to all vertices of the whole
    faces: Ints  # (m,)
    places: Floats  # (m, 3)
    changes: Floats  # (m,) mean change of the distances to near samples, beyond their intervals


def points_of(part: View, whole: View, places: Indices, turn: float, threads: int | None) -> Points:
    """Move samples from the samples of the whole to its vertices, then place all vertices, given their samples."""
    every = np.arange(len(places))
    images = _moved(part, whole, part.samples, whole.samples[places], every, whole.rows[places], turn)
    rows = distance_rows(stencils_of(whole.surface), images.astype(np.int32), None, "spherical", threads) / whole.unit
    vertices = np.arange(len(part.surface.vertices))
    owners = part.nearest.astype(np.int64)
    nearest = _moved(part, whole, vertices, images[owners], owners, rows, turn)
    pairs = pairs_of(part, vertices, every, _SCALE)
    faces = whole.surface.faces
    order = np.argsort(faces.ravel(), kind="stable")
    starts = np.searchsorted(faces.ravel()[order], np.arange(len(whole.surface.vertices) + 1))
    found, ends, changes = np.empty(len(vertices), np.int32), np.empty((len(vertices), 3)), np.empty(len(vertices))
    there = np.ascontiguousarray(rows.T)
    _project(pairs.low, pairs.high, pairs.weights, nearest, there, faces, order, starts, found, ends, changes)
    return Points(images, rows, found, ends, changes)


def _moved(
    part: View, whole: View, points: Indices, guesses: Indices, owners: Indices, rows: Floats, turn: float
) -> Indices:
    """Return the best vertex of the whole for some vertices of the piece, near the image of their `owners`, samples."""
    courses = turned(directions_of(whole.surface, whole.orientation.sign, rows), turn)
    pairs = pairs_of(part, points, np.arange(len(rows)), _SCALE)
    strength = TURNING if turn else 0.0
    looks = vertex_looks(part, whole, points)
    return assign(looks, pairs, np.ascontiguousarray(rows.T), courses, guesses, owners, rows, _MOVE, strength)[0]


@kernel
def _project(low, high, weights, nearest, there, faces, order, starts, found, ends, changes):
    """Write the point of the faces around each `nearest` vertex whose distances are nearest to their intervals.

    Distances are linear in each triangle. An interval's nearest end counts, or the distance itself if it is within.
    """
    samples = there.shape[1]
    wanted, gram, trial = np.empty(samples), np.empty((3, 3)), np.empty(3)
    for point in range(len(nearest)):
        for sample in range(samples):
            distance = there[nearest[point], sample]
            wanted[sample] = min(max(distance, low[point, sample]), high[point, sample])
        best = np.inf
        for index in range(starts[nearest[point]], starts[nearest[point] + 1]):
            face = order[index] // 3
            for i in range(3):
                for j in range(i, 3):
                    total = 0.0
                    for sample in range(samples):
                        one = there[faces[face, i], sample] - wanted[sample]
                        total += weights[point, sample] * one * (there[faces[face, j], sample] - wanted[sample])
                    gram[i, j] = total
                    gram[j, i] = total
            squared = closest(gram, trial)
            if squared < best:
                best = squared
                found[point] = face
                ends[point] = trial
        changes[point] = 0.0
        for sample in range(samples):
            distance = 0.0
            for i in range(3):
                distance += ends[point, i] * there[faces[found[point], i], sample]
            error = max(distance - high[point, sample], low[point, sample] - distance, 0.0)
            changes[point] += weights[point, sample] * error
