"""Strips of triangles, as in glb and ply files: each corner forms a triangle with the previous two."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Bools, Indices
from unbend.mesh.formats.spans import firsts_of, spans


def strip_faces(corners: Indices, separators: Bools) -> Indices:
    """Return the triangles (m, 3) of consecutive strips in `corners` (k,).

    `separators` (k,) are True at entries that are not corners but separate two strips. Every second triangle of a strip
    is reversed, so that all have the same orientation.
    """
    edges = np.flatnonzero(np.concatenate([[True], separators, [True]]))
    lengths = np.maximum(np.diff(edges) - 3, 0)
    first = spans(edges[:-1], lengths)
    faces = np.stack([corners[first], corners[first + 1], corners[first + 2]], axis=1)
    odd = (np.arange(len(first)) - np.repeat(firsts_of(lengths), lengths)) % 2 == 1
    faces[odd] = faces[odd][:, ::-1]
    return faces
