"""Removal of invalid and repeated faces, and counts of defects."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Bools, Floats, Ints
from unbend.errors import MeshGeometryError
from unbend.mesh.report import MeshReport
from unbend.mesh.rows import equal_faces
from unbend.mesh.surface import Surface
from unbend.tolerances import DEGENERATE_HEIGHT


def cleaned(vertices: Floats, faces: Ints, report: MeshReport) -> Surface:
    """Return the surface of all valid faces, with the findings in its report.

    Faces are dropped if a coordinate is not finite, if they repeat a vertex, or if they have the corners of an earlier
    face. Faces of zero area stay, because they may connect other faces.

    Raises
    ------
    MeshGeometryError
        If no face with an area is left. The message names a vertex that is not finite, if there is one.
    """
    faces, nonfinite, report = _drop_nonfinite(vertices, faces, report)
    faces, report = drop_repeats(faces, len(vertices), report)
    problem = "no face has three different vertices"
    if len(faces):
        surface = Surface(vertices, faces)
        if surface.area > 0:
            return surface.with_report(
                report.adding(
                    isolated_vertices=len(vertices) - len(surface.used_vertices),
                    zero_area_faces=_count_slivers(surface),
                )
            )
        problem = "every face has zero area"
    if len(nonfinite):
        row = int(nonfinite[0])
        raise MeshGeometryError(
            f"vertex {row} has coordinates {vertices[row].tolist()}, which are not finite, and no face with an area "
            "is left without such vertices"
        )
    raise MeshGeometryError(problem)


def drop_repeats(faces: Ints, vertex_count: int, report: MeshReport) -> tuple[Ints, MeshReport]:
    """Drop faces that repeat a vertex or an earlier face."""
    twice, again = find_repeats(faces, vertex_count)
    report = report.adding(degenerate_faces=int(twice.sum()), duplicate_faces=int(again.sum()))
    dropped = twice | again
    return faces[~dropped] if dropped.any() else faces, report


def find_repeats(faces: Ints, vertex_count: int) -> tuple[Bools, Bools]:
    """Return masks of the `faces` (m, 3) that repeat a vertex, and of the faces with the corners of an earlier face."""
    a, b, c = faces.T
    twice: Bools = (a == b) | (b == c) | (c == a)
    again: Bools = ~twice & (equal_faces(faces, vertex_count) != np.arange(len(faces)))
    return twice, again


def _drop_nonfinite(vertices: Floats, faces: Ints, report: MeshReport) -> tuple[Ints, Ints, MeshReport]:
    if np.isfinite(vertices).all():
        return faces, faces[:0, 0], report
    bad = np.zeros(len(vertices), bool)
    bad[np.flatnonzero(~np.isfinite(vertices).all(axis=1))] = True
    touching = np.flatnonzero(bad[faces].any(axis=1))
    corners = faces[touching].ravel()
    culprits = np.unique(corners[bad[corners]])
    counted = report.adding(nonfinite_faces=len(touching), nonfinite_vertices=len(culprits))
    return np.delete(faces, touching, axis=0), culprits, counted


def _count_slivers(surface: Surface) -> int:
    # No edge is longer than the diagonal of the bounding box, so only a few faces need their edges measured.
    limit = DEGENERATE_HEIGHT * surface.extent * 3**0.5
    thin = np.flatnonzero(2 * surface.face_areas <= limit * surface.extent * 3**0.5)
    corners = surface.vertices[surface.faces[thin]] / surface.scale
    edges = corners - np.roll(corners, 1, axis=1)
    longest = np.sqrt((edges**2).sum(axis=2).max(axis=1))
    heights_times_longest = 2 * surface.face_areas[thin] / surface.scale**2
    return int((heights_times_longest <= DEGENERATE_HEIGHT * longest**2).sum())
