"""The match of a piece with its whole."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from unbend.correspondence.candidates import has_rival
from unbend.correspondence.correspondence import Candidate, Correspondence
from unbend.correspondence.parts.candidates import Placed, placings, size_ratio
from unbend.correspondence.parts.orientation import agreement
from unbend.correspondence.parts.points import Points, points_of
from unbend.correspondence.parts.views import View, views_of
from unbend.mesh.surface import Surface

_ENLARGED: Final = (0.8, 1.25)
"""A piece of another person may be this much smaller or larger than its place."""

_SIMILAR: Final = 0.02
"""Change of size that does not matter, in logarithms."""

_LEAST_AGREEMENT: Final = 0.2


def match_part(part: Surface, whole: Surface, samples: int, turn: float, threads: int | None) -> Correspondence:
    """Find for each vertex of a piece the point of its whole, which has the same unit of length.

    Parameters
    ----------
    part, whole : Surface
        All vertices have faces.
    samples : int
    turn : float
        1 for maps that keep the orientation, -1 for those that reverse it, 0 for either.
    threads : int, optional
    """
    ours, theirs = views_of(part, whole, samples, threads)
    known = ours.orientation.known and theirs.orientation.known
    turns = (0.0,) if not known else (turn,) if turn else (1.0, -1.0)
    ratio = float(np.clip(size_ratio(ours, theirs, turns[0]), *_ENLARGED))
    if abs(np.log(ratio)) > _SIMILAR:
        ours = ours.scaled(ratio)
    found = placings(ours, theirs, turns)
    points = points_of(ours, theirs, found[0].places, found[0].turn, threads)
    return _result(whole, ours, theirs, found, points, oriented=known and turn != 0)


def _result(
    whole: Surface, ours: View, theirs: View, found: list[Placed], points: Points, *, oriented: bool
) -> Correspondence:
    chosen = found[0]
    agreed = agreement(ours, theirs, points.images) * (chosen.turn or 1.0)
    figures = tuple(_with_distance(one, ours, theirs, points) for one in found)
    shares = ours.surface.vertex_areas / ours.surface.area
    return Correspondence(
        faces=points.faces,
        barycentric=points.places,
        target_faces=whole.faces,
        target_vertices=len(whole.vertices),
        confidence=np.exp(-points.changes / max(theirs.radius, np.finfo(np.float64).tiny)),
        residual=float(shares @ points.changes),
        oriented=oriented and agreed >= _LEAST_AGREEMENT,
        ambiguous=has_rival(figures, theirs.radius),
        candidates=figures,
    )


def _with_distance(one: Placed, ours: View, theirs: View, points: Points) -> Candidate:
    every = np.arange(len(one.places))
    return replace(one.figures, distance=float(ours.weights @ points.rows[every, theirs.samples[one.places]]))
