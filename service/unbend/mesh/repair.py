"""From raw vertices and faces to a `Surface`: count what is wrong, mend it, and say so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.errors import MeshGeometryError
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.report import MeshReport
from unbend.mesh.surface import Surface
from unbend.mesh.topology import face_components, find_edges


def repair(vertices: Floats, faces: Indices, *, file_type: str = "", policy: MeshPolicy | None = None) -> Surface:
    """Return the surface that raw `vertices` (n, 3) and `faces` (m, 3) describe.

    Faces that repeat a vertex or another face are dropped, and `policy` says what happens to further
    components. Vertices are never dropped, moved or renumbered.

    Raises
    ------
    MeshGeometryError
        If an index is out of range, a used coordinate is not finite, no face with an area is left, or the
        policy refuses the mesh.
    """
    policy = policy or MeshPolicy()
    raw = Surface(vertices, faces.astype(np.int32) if _fits(faces) else faces)  # checks ranges and coordinates
    report = MeshReport(file_type=file_type, vertices=len(raw.vertices), faces=len(raw.faces))
    kept, report = _drop_useless(raw.faces, report)
    kept, report = _choose_component(raw, kept, policy, report)
    surface = Surface(raw.vertices, kept, _count(kept, raw, report))
    if not surface.area > 0:
        raise MeshGeometryError("every face has zero area")
    return surface


def _fits(faces: Indices) -> bool:
    limit = np.iinfo(np.int32).max
    if faces.size and (faces.max() > limit or faces.min() < -limit):
        raise MeshGeometryError(f"a face uses vertex {int(np.abs(faces).max())}, which no mesh we read can have")
    return True


def _drop_useless(faces: Ints, report: MeshReport) -> tuple[Ints, MeshReport]:
    corners = np.sort(faces, axis=1)
    repeats = (corners[:, 0] == corners[:, 1]) | (corners[:, 1] == corners[:, 2])
    kept, corners = faces[~repeats], corners[~repeats]
    if len(kept) == 0:
        raise MeshGeometryError("no face has three different vertices")
    _, first = np.unique(corners, axis=0, return_index=True)
    degenerate, duplicate = int(repeats.sum()), len(kept) - len(first)
    notes = [
        f"{count} {what} dropped"
        for count, what in ((degenerate, "faces that repeat a vertex"), (duplicate, "duplicate faces"))
        if count
    ]
    if duplicate:
        kept = kept[np.sort(first)]
    counted = replace(report, degenerate_faces=degenerate, duplicate_faces=duplicate)
    return kept, replace(counted, notes=(*report.notes, *notes))


def _choose_component(raw: Surface, faces: Ints, policy: MeshPolicy, report: MeshReport) -> tuple[Ints, MeshReport]:
    count, component = face_components(faces, len(raw.vertices))
    if count == 1:
        return faces, replace(report, components=1)
    if policy.components == "error":
        raise MeshGeometryError(f"the mesh has {count} components, and the policy allows one")
    areas = np.bincount(component, Surface(raw.vertices, faces).face_areas, minlength=count)
    largest = int(areas.argmax())
    share = areas[largest] / areas.sum() if areas.sum() > 0 else 0.0
    note = f"{count} components: kept the largest, with {share:.1%} of the area"
    return faces[component == largest], replace(report, components=count, notes=(*report.notes, note))


def _count(faces: Ints, raw: Surface, report: MeshReport) -> MeshReport:
    edges = find_edges(faces, len(raw.vertices))
    isolated = len(raw.vertices) - len(raw.used_vertices)
    notes = [
        f"{count} {what}"
        for count, what in (
            (isolated, "vertices belong to no face: distances to them are infinite"),
            (edges.boundary, "boundary edges: the surface is open"),
            (edges.nonmanifold, "edges have three faces or more"),
        )
        if count
    ]
    return replace(
        report,
        boundary_edges=edges.boundary,
        nonmanifold_edges=edges.nonmanifold,
        isolated_vertices=isolated,
        notes=(*report.notes, *notes),
    )
