"""The match of a piece with its whole."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from unbend.correspondence.candidates import has_rival
from unbend.correspondence.correspondence import Correspondence
from unbend.correspondence.parts.candidates import Placed, placings, size_ratio
from unbend.correspondence.parts.points import Refined, points_of, refine
from unbend.correspondence.parts.views import View, views_of
from unbend.mesh.surface import Surface

_ENLARGED: Final = (0.8, 1.25)
"""A piece of another person may be this much smaller or larger than its place."""

_SIMILAR: Final = 0.02
"""Change of size that does not matter, in logarithms."""


def match_part(part: Surface, whole: Surface, samples: int, turn: float, threads: int | None) -> Correspondence:
    """Find for each vertex of a piece its point on the whole. Both surfaces have the same unit of length.

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
    chosen = refine(ours, theirs, found[0], threads)
    return _result(whole, ours, theirs, found, chosen, oriented=known and turn != 0)


def _result(
    whole: Surface, ours: View, theirs: View, found: list[Placed], chosen: Refined, *, oriented: bool
) -> Correspondence:
    points = points_of(ours, theirs, chosen)
    every = np.arange(len(chosen.images))
    apart = [float(ours.weights @ chosen.rows[every, theirs.samples[one.places]]) for one in found]
    figures = [replace(one.judgement.figures, distance=far) for one, far in zip(found, apart, strict=True)]
    shares = ours.surface.vertex_areas / ours.surface.area
    return Correspondence(
        faces=points.faces,
        barycentric=points.barycentric,
        target_faces=whole.faces,
        target_vertices=len(whole.vertices),
        confidence=np.exp(-points.changes / max(theirs.radius, np.finfo(np.float64).tiny)),
        residual=float(shares @ points.changes),
        oriented=oriented and chosen.judgement.oriented,
        ambiguous=has_rival(figures, theirs.radius),
        candidates=tuple(figures),
    )
