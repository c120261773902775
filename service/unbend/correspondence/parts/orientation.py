"""Whether a map keeps the orientation of small triangles."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.correspondence.parts.directions import vertex_normals
from unbend.correspondence.parts.views import View

_NEIGHBOURS: Final = 6


def agreement(part: View, whole: View, images: Indices) -> float:
    """Return how far the triangles of near samples and those of their images, vertices of the whole, agree.

    Each sample and two of its six neighbours make a triangle. Its volume with the normal is positive if its corners are
    counted anticlockwise. The result is the correlation of the volumes: 1 if all agree, -1 if all are reversed.
    """
    between = part.rows[:, part.samples]
    near = np.argsort(between, axis=1, kind="stable")[:, 1 : _NEIGHBOURS + 1]
    ours, theirs = _volumes(part, part.samples, near), _volumes(whole, images, near)
    size = np.sqrt((ours**2).sum() * (theirs**2).sum())
    return float((ours * theirs).sum() / size) if size > 0 else 0.0


def _volumes(view: View, vertices: Indices, near: Indices) -> Floats:
    points = view.surface.vertices[vertices] / view.unit
    sides = points[near] - points[:, None]
    normals = vertex_normals(view.surface, view.orientation.sign)[vertices]
    return np.asarray(np.einsum("pijk,pk->pij", np.cross(sides[:, :, None], sides[:, None]), normals))
