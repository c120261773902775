"""From places of samples to a point on the triangles of the whole for each vertex of a piece."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.correspondence.parts.assignment import TURNING, assign
from unbend.correspondence.parts.candidates import Placed
from unbend.correspondence.parts.directions import Directions, directions_of
from unbend.correspondence.parts.judgement import Judgement, Map, judge
from unbend.correspondence.parts.looks import rings_differ, sample_looks, vertex_looks
from unbend.correspondence.parts.pairs import pairs_of
from unbend.correspondence.parts.placing import SCALE, turned
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
class Refined:
    """A map of the samples of a piece to vertices of its whole."""

    images: Indices  # (S,)
    rows: Floats  # (S, n) distances from each to all vertices of the whole
    courses: Directions  # (n, S) directions away from each
    judgement: Judgement


@dataclass(frozen=True, eq=False)
class Points:
    """A point of the whole for each vertex of a piece."""

    faces: Ints  # (m,)
    barycentric: Floats  # (m, 3) weights of the corners of the face
    changes: Floats  # (m,) mean change of the distances to near samples, beyond their intervals


def refine(part: View, whole: View, found: Placed, threads: int | None) -> Refined:
    """Move samples from the samples of the whole to its vertices, and judge the map again."""
    every, turn = np.arange(len(found.places)), found.judgement.turn
    courses = np.ascontiguousarray(turned(whole.courses, turn)[:, found.places])
    at = whole.samples[found.places]
    images = _assigned(part, whole, part.samples, at, every, whole.rows[found.places], courses, turn)
    rows = distance_rows(stencils_of(whole.surface), images.astype(np.int32), None, "spherical", threads) / whole.unit
    courses = turned(directions_of(whole.surface, whole.orientation.sign, rows), turn)
    rings = rings_differ(sample_looks(part, whole), found.places)
    refined = Map(images, rows[:, images].T, courses[images], rings, turn)
    return Refined(images, rows, courses, judge(part, whole, pairs_of(part, part.samples, every, SCALE), refined))


def points_of(part: View, whole: View, found: Refined) -> Points:
    """Place all vertices of a piece, given the images of its samples."""
    vertices, owners = np.arange(len(part.surface.vertices)), part.nearest.astype(np.int64)
    turn = found.judgement.turn
    nearest = _assigned(part, whole, vertices, found.images[owners], owners, found.rows, found.courses, turn)
    pairs = pairs_of(part, vertices, np.arange(len(found.images)), _SCALE)
    faces = whole.surface.faces
    order = np.argsort(faces.ravel(), kind="stable")
    starts = np.searchsorted(faces.ravel()[order], np.arange(len(whole.surface.vertices) + 1))
    faces_of, ends = np.empty(len(vertices), np.int32), np.empty((len(vertices), 3))
    changes = np.empty(len(vertices))
    there = np.ascontiguousarray(found.rows.T)
    _project(pairs.low, pairs.high, pairs.weights, nearest, there, faces, order, starts, faces_of, ends, changes)
    return Points(faces_of, ends, changes)


def _assigned(
    part: View,
    whole: View,
    points: Indices,
    guesses: Indices,
    owners: Indices,
    rows: Floats,
    courses: Directions,
    turn: float,
) -> Indices:
    """Return for each of `points` the best vertex of the whole near the image of its owner, a sample."""
    pairs = pairs_of(part, points, np.arange(len(rows)), _SCALE)
    strength = TURNING if turn else 0.0
    looks = vertex_looks(part, whole, points)
    return assign(looks, pairs, np.ascontiguousarray(rows.T), courses, guesses, owners, rows, _MOVE, strength)[0]


@kernel
def _project(low, high, weights, nearest, there, faces, order, starts, found, ends, changes):
    """Write, for each point, the place in the faces around its `nearest` vertex that fits the wanted distances best.

    Distances are linear in each triangle. Wanted are the distances of the `nearest` vertex, limited to the intervals.
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
