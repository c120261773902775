"""`match`: which point of one surface is which point of another."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, Literal, get_args

import numpy as np

from unbend.arrays import Floats, Indices, Ints, Singles
from unbend.correspondence.candidates import FINE, Judged, has_rival, judged_candidates, refine
from unbend.correspondence.correspondence import Correspondence
from unbend.correspondence.features import Features, features_of
from unbend.correspondence.growth import embedded
from unbend.correspondence.nearest import nearest_rows
from unbend.correspondence.parts.match import match_part
from unbend.correspondence.pieces import Part, is_part
from unbend.correspondence.projection import project
from unbend.errors import ParameterError, check_choice
from unbend.geodesics.distances import distance_rows
from unbend.geodesics.stencils import stencils_of
from unbend.mesh.surface import Surface
from unbend.threads import one_blas_thread

SAMPLES: Final = 300
"""Samples of each surface by default."""

Turn = Literal["keep", "reverse", "any"]
"""Whether a map keeps the orientation of the triangles, reverses it, or either."""

_FEWEST: Final = 20  # samples
_TURNS: Final[dict[Turn, float]] = {"keep": 1.0, "reverse": -1.0, "any": 0.0}
_REFINED: Final = 2  # candidates that are grown on all vertices
_REACH: Final = 2.0  # a vertex is searched within this many radii of both samplings around the image of its sample


@one_blas_thread()  # sums of BLAS depend on the number of its threads
def match(
    a: Surface,
    b: Surface,
    *,
    samples: int = SAMPLES,
    orientation: Turn = "keep",
    part: Part = "auto",
    threads: int | None = None,
) -> Correspondence:
    """Find for each vertex of `a` the point of `b` that is the same place, however both are bent.

    Neither landmarks nor training are needed. Candidates are alignments of the canonical forms, with all reflections
    (`unbend.correspondence.starts`). Each grows into a map of the functions on the surfaces
    (`unbend.correspondence.growth`), which keeps geodesic distances, oriented planes and curvature as far as the
    surfaces agree in them. The best candidate is projected onto the triangles of `b`.

    `a` may also be a piece of `b` (`unbend.correspondence.parts`).

    Parameters
    ----------
    a, b : Surface
        Connected surfaces of the same kind of object, such as two persons or two poses; their scale does not matter. A
        piece and its whole must have the same unit of length.
    samples : int, default 300
        Farthest point samples of each surface, at least 20. More cost more time and memory.
    orientation : {"keep", "reverse", "any"}, default "keep"
        Which maps are allowed. "keep" tells left from right. "reverse" finds mirror images. The faces of both surfaces
        must agree on their sides; otherwise the result says that the orientation decided nothing.
    part : {"auto", "no", "a"}, default "auto"
        Whether `a` is a piece of `b`. "auto" takes it for one if it is open and `b` is not, and it has from .05 to .95
        of the area of `b`.
    threads : int, optional
        Threads for distances, all cores by default. The result does not depend on it.

    Returns
    -------
    Correspondence

    Raises
    ------
    MeshGeometryError
        If a surface has no area, or its faces are not connected.
    ParameterError
        If `samples`, `orientation`, `part` or `threads` is out of range.
    UnsuitedError
        If `b` looks like a piece of `a` and `part` is "auto".

    Examples
    --------
    >>> from unbend.mesh.shapes import ellipsoid
    >>> body = ellipsoid((1.0, 0.7, 0.4))
    >>> found = match(body, body, samples=100)
    >>> found.faces.shape, found.barycentric.shape
    ((642,), (642, 3))
    """
    check_choice("orientation", orientation, get_args(Turn))
    if samples < _FEWEST:
        raise ParameterError(f"samples must be at least {_FEWEST}, not {samples}")
    piece = is_part(a, b, part)
    ours, theirs = _used(a), _used(b)
    if piece:
        return _at_all(match_part(ours, theirs, samples, _TURNS[orientation], threads), a, b)
    first = features_of(ours, samples, threads)
    second = first if ours is theirs else features_of(theirs, samples, threads)
    turn = _TURNS[orientation] if first.orientation.known and second.orientation.known else 0.0
    judged = judged_candidates(first.at_samples(), second.at_samples(), turn)
    refined = [refine(first, second, candidate, turn) for candidate in judged[:_REFINED]]
    best = min(range(len(refined)), key=lambda number: refined[number].sort_key())
    order = [best, *(number for number in range(len(judged)) if number != best)]
    return _result(a, b, first, second, refined[best], [judged[number] for number in order], turn, threads)


def _at_all(found: Correspondence, a: Surface, b: Surface) -> Correspondence:
    """Return a correspondence of the used vertices of both surfaces as one of all vertices."""
    count, used = len(a.vertices), a.used_vertices
    faces, places, confidence = np.full(count, -1, np.int32), np.full((count, 3), np.nan), np.zeros(count)
    faces[used], places[used], confidence[used] = found.faces, found.barycentric, found.confidence
    return replace(
        found,
        faces=faces,
        barycentric=places,
        confidence=confidence,
        target_faces=b.faces,
        target_vertices=len(b.vertices),
    )


def _used(surface: Surface) -> Surface:
    """Return the surface without vertices that no face uses."""
    used = surface.used_vertices
    if len(used) == len(surface.vertices):
        return surface
    numbers = np.zeros(len(surface.vertices), np.int32)
    numbers[used] = np.arange(len(used))
    return Surface(surface.vertices[used], numbers[surface.faces])


def _result(
    a: Surface,
    b: Surface,
    first: Features,
    second: Features,
    chosen: Judged,
    judged: list[Judged],
    turn: float,
    threads: int | None,
) -> Correspondence:
    every, sources = np.arange(len(chosen.map.to)), chosen.map.to.astype(np.int32)
    rows = distance_rows(stencils_of(second.surface), sources, None, "spherical", threads) / second.unit
    ours, theirs = embedded(first, second, chosen.map, FINE[-1], turn)
    nearest = _nearest_within(first, second, ours, theirs, rows)
    faces, places = project(ours, nearest, theirs, second.surface.faces)
    changes = _changes(first, rows, second.surface.faces[faces], places)
    figures = tuple(
        replace(one.figures, distance=float(first.weights @ rows[every, second.samples[one.map.to]])) for one in judged
    )
    shares = first.surface.vertex_areas / first.surface.area
    found = Correspondence(
        faces=faces,
        barycentric=places,
        target_faces=b.faces,
        target_vertices=len(b.vertices),
        confidence=np.exp(-changes / max(second.radius, np.finfo(np.float64).tiny)),
        residual=float(shares @ changes),
        oriented=chosen.oriented,
        ambiguous=has_rival(figures, second.radius),
        candidates=figures,
    )
    return _at_all(found, a, b)


def _nearest_within(a: Features, b: Features, ours: Singles, theirs: Singles, rows: Floats) -> Indices:
    """Return the nearest vertex of b in the embedding for each of a, among those around the image of its sample."""
    reach = _REACH * (a.radius + b.radius)
    nearest = np.empty(len(ours), np.int64)
    order = np.argsort(a.nearest, kind="stable")
    bounds = np.searchsorted(a.nearest[order], np.arange(len(a.samples) + 1))
    for sample in range(len(a.samples)):
        cell = order[bounds[sample] : bounds[sample + 1]]
        around = np.flatnonzero(rows[sample] <= reach)
        nearest[cell] = around[nearest_rows(ours[cell], theirs[around])]
    return nearest


def _changes(a: Features, rows: Floats, corners: Ints, places: Floats) -> Floats:
    """Return the mean change of each vertex's distances to near samples, (n,)."""
    total, weight = np.zeros(len(corners)), np.zeros(len(corners))
    for sample in range(len(a.samples)):
        own = a.rows[sample]
        near = np.flatnonzero(own <= _REACH * 2 * a.radius)
        there = (rows[sample][corners[near]] * places[near]).sum(axis=1)
        total[near] += a.weights[sample] * np.abs(own[near] - there)
        weight[near] += a.weights[sample]
    return total / weight
