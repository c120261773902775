"""Repair: from raw vertices and faces to a `Surface`, with a report of defects and repairs."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
from numpy.typing import ArrayLike

from unbend.errors import MeshGeometryError
from unbend.mesh.bridge import bridge
from unbend.mesh.census import take_census
from unbend.mesh.clean import cleaned
from unbend.mesh.components import largest_component
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.report import MeshReport, counted_noun
from unbend.mesh.roughness import ROUGH, roughness
from unbend.mesh.rows import equal_points
from unbend.mesh.simplify import simplify, through
from unbend.mesh.smooth import smoothed_vertices
from unbend.mesh.stitch import stitched
from unbend.mesh.surface import Surface, check_mesh
from unbend.tolerances import AREA_KEPT, DEGENERATE_HEIGHT


def repair(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    file_type: str = "",
    notes: tuple[str, ...] = (),
    policy: MeshPolicy | None = None,
) -> Surface:
    """Return the surface of raw `vertices` (n, 3) and `faces` (m, 3).

    Faces with a coordinate that is not finite, with a repeated vertex, or equal to an earlier face are dropped.
    `policy` determines the treatment of seams, further components, noise and large meshes. Vertices keep their indices
    unless seams are joined or the mesh is simplified; `vertex_map` then maps them. Only smoothing and simplification
    move vertices, except that joined copies of a vertex take the coordinates of the first copy. `notes` are the
    reader's sentences for the report.

    Raises
    ------
    MeshGeometryError
        If an index is out of range, squared lengths leave the range of double precision, no face with an area is
        left, or the policy refuses the mesh.
    """
    policy = policy or MeshPolicy()
    points, corners = np.asarray(vertices, np.float64), np.asarray(faces)
    check_mesh(points, corners)
    report = MeshReport(file_type=file_type, vertices=len(points), faces=len(corners), notes=notes)
    surface = cleaned(points, corners.astype(np.int32, copy=False), report)
    surface = _stitched(surface, policy)
    surface = _choose_component(surface, policy)
    surface = surface.with_report(surface.report.adding(**asdict(take_census(surface))).described())
    surface = _smoothed(surface, policy.smooth)
    if policy.max_vertices is None or len(surface.used_vertices) <= policy.max_vertices:
        return _bridged(surface) if policy.components == "bridge" else surface
    # Links come last, because simplification may separate parts that only a vertex connects.
    return _bridged(_simplified(surface, policy.max_vertices))


def _stitched(surface: Surface, policy: MeshPolicy) -> Surface:
    """Join seams if the policy says so, and count the vertices that still coincide with another vertex."""
    places = equal_points(surface.vertices).astype(np.int32)
    result = stitched(surface, places) if policy.seams == "stitch" else surface
    if result.vertex_map is not None:
        first = np.empty(len(result.vertices), np.int64)
        # The last assignment to an index wins, which is that of the lowest copy.
        first[result.vertex_map[::-1]] = np.arange(len(places))[::-1]
        places = places[first]
    taken = np.zeros(len(surface.vertices), bool)
    taken[places[result.used_vertices]] = True
    report = result.report.adding(coincident_vertices=len(result.used_vertices) - int(taken.sum()))
    if report.seam_tolerance is not None:
        gap = f"{report.seam_tolerance:.3g}"
        report = report.adding(f"ends of edges up to {gap} apart were joined: they differ in the last digits")
    return result.with_report(report)


def _choose_component(surface: Surface, policy: MeshPolicy) -> Surface:
    faces, count, share = largest_component(surface)
    report = surface.report.adding(components=count)
    if count == 1 or policy.components == "bridge":
        return surface.with_report(report)
    if policy.components == "error":
        raise MeshGeometryError(f"the mesh has {count} components, and the policy allows one")
    note = f"{count:,} components: kept the largest, with {share:.1%} of the area"
    report = report.adding(note, area_kept=share)
    if share < AREA_KEPT:
        report = report.warning(_loss(count, share, policy))
    return replace(surface, faces=faces, report=report)


def _loss(count: int, share: float, policy: MeshPolicy) -> str:
    advice = 'the policy components="bridge" connects all of them'
    if policy.seams == "keep":
        advice = f'seams="stitch" joins components that only a seam separates, and {advice}'
    return (
        f"only {share:.1%} of the area was kept, the largest of {count:,} components, so results may describe only a "
        f"part of the shape: {advice}"
    )


def _smoothed(surface: Surface, rounds: int) -> Surface:
    """Smooth `surface` if the policy says so; otherwise add a note to the report if the surface is rough."""
    rough = roughness(surface)
    report = surface.report.adding(roughness=rough)
    if rounds == 0:
        note = "the surface is rough, perhaps from noise: the policy `smooth` reduces noise"
        return surface.with_report(report.adding(note if rough > ROUGH else None))
    smoothed = replace(surface, vertices=smoothed_vertices(surface, rounds))
    change, given = smoothed.area / surface.area - 1, counted_noun(rounds, "round", "rounds")
    if not smoothed.area > DEGENERATE_HEIGHT * surface.area:
        raise MeshGeometryError(f"after {given} of smoothing no area is left: the mesh has too few vertices")
    note = f"smoothed in {given}: the area changed by {change:+.2%}"
    return smoothed.with_report(report.adding(note, smoothing_rounds=rounds, area_change=change))


def _simplified(surface: Surface, most: int) -> Surface:
    simple = simplify(surface, most)
    relative = simple.deviation / surface.area**0.5
    lost = int((simple.vertex_map[surface.used_vertices] < 0).sum())
    note = (
        f"simplified from {len(surface.used_vertices):,} to {len(simple.vertices):,} vertices: none was farther from "
        f"the result than {simple.deviation:.3g}, {relative:.2%} of the square root of the area"
    )
    if lost:
        note += f"; {counted_noun(lost, 'vertex has', 'vertices have')} no counterpart: their component was removed"
    report = surface.report.adding(
        note, simplified_vertices=len(simple.vertices), deviation=simple.deviation, relative_deviation=relative
    )
    where = simple.vertex_map if surface.vertex_map is None else through(surface.vertex_map, simple.vertex_map)
    result = Surface(simple.vertices, simple.faces, report, where)
    if not result.area > 0:
        raise MeshGeometryError(f"every face has zero area after simplification to {most:,} vertices")
    return result


def _bridged(surface: Surface) -> Surface:
    bridges = bridge(surface)
    count = len(bridges.lengths)
    if count == 0:
        return surface
    longest = float(bridges.lengths.max())
    note = (
        f"{counted_noun(count, 'link', 'links')} between {count + 1:,} components added, the longest {longest:.3g} "
        f"long; {bridges.area / surface.area:.2%} was added to the area"
    )
    report = surface.report.adding(note, links=count, longest_link=longest, link_area=bridges.area)
    return replace(surface, faces=np.concatenate([surface.faces, bridges.faces]), report=report)
