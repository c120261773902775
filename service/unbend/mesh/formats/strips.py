"""Strips of triangles, as glb and ply files have them: each corner makes a triangle with the two before it."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Bools, Indices
from unbend.mesh.formats.spans import firsts_of, spans


def strip_faces(corners: Indices, separators: Bools) -> Indices:
    """Return the triangles (m, 3) of strips that lie one after the other in `corners` (k,).

    `separators` (k,) are True where an entry is no corner but separates two strips. Every second triangle of a strip
    is turned around, so that all face the same side.
    """
    edges = np.flatnonzero(np.concatenate([[True], separators, [True]]))
    lengths = np.maximum(np.diff(edges) - 3, 0)
    first = spans(edges[:-1], lengths)
    faces = np.stack([corners[first], corners[first + 1], corners[first + 2]], axis=1)
    odd = (np.arange(len(first)) - np.repeat(firsts_of(lengths), lengths)) % 2 == 1
    faces[odd] = faces[odd][:, ::-1]
    return faces
