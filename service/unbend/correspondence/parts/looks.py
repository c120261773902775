"""The looks of a surface around a point: areas of circles, which bending keeps, and mean and Gaussian curvature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.correspondence.curvature import SCALES
from unbend.correspondence.parts.views import OUTER, View

LARGEST: Final = 3.0
"""Most that looks count against a place."""

_RING: Final = 1 / 13
"""Weight of the squared difference of a ring that the piece has completely."""

_CURVATURE: Final = 0.3
"""Weight of the squared difference of a curvature."""

_MARGIN: Final = 2 * SCALES[-1]
"""Distance from the boundary from which curvature counts fully."""


@dataclass(frozen=True, eq=False)
class Looks:
    """Descriptions of points of a piece, (k, f), and of places on its whole, (n, f), and how far each counts."""

    ours: Floats
    theirs: Floats
    trust: Floats  # (k, f)


def sample_looks(part: View, whole: View) -> Looks:
    """Compare circles and curvature of all samples."""
    rings = np.where(part.reach[part.samples][:, None] >= OUTER, _RING, 0.0)
    return Looks(
        np.hstack([part.rings, part.curvatures[part.samples]]),
        np.hstack([whole.rings, whole.curvatures[whole.samples]]),
        np.hstack([rings, _curvature_trust(part, part.samples)]),
    )


def vertex_looks(part: View, whole: View, points: Indices) -> Looks:
    """Compare the curvature of some vertices of a piece and of all vertices of its whole."""
    return Looks(part.curvatures[points], whole.curvatures, _curvature_trust(part, points))


def rings_differ(looks: Looks, places: Indices) -> Floats:
    """Return how much the circles around each sample differ from those of its place, (k,)."""
    squared = looks.trust * (looks.ours - looks.theirs[places]) ** 2
    return np.asarray(np.minimum(squared[:, : -2 * len(SCALES)].sum(axis=1), LARGEST))


def curvature_differs(part: View, whole: View, points: Indices, images: Indices) -> Floats:
    """Return how much the curvature at each point differs from that at its image, (k,)."""
    squared = _curvature_trust(part, points) * (part.curvatures[points] - whole.curvatures[images]) ** 2
    return np.asarray(np.minimum(squared.sum(axis=1), LARGEST))


def _curvature_trust(part: View, points: Indices) -> Floats:
    inside = np.minimum(part.reach[points] / _MARGIN, 1.0)
    return np.asarray(np.repeat(_CURVATURE * inside[:, None], 2 * len(SCALES), axis=1))
