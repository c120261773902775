"""Retrieval of shapes whose files split vertices, and the time of stitching seams.

Every 16th mesh of shrec11_simplified is a query, and the gallery then lacks that mesh. Uses the default parameters and
measure, and takes two minutes. Writes the section "seams" of docs/benchmarks/robustness.md.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from benchmarks.common import BENCHMARKS, best_of, table, write_section
from benchmarks.retrieval.data import in_processes, listed, signatures_of
from unbend import MeshPolicy, Surface, compute_signature, read_mesh
from unbend.arrays import Floats, Indices
from unbend.matching.measures import DEFAULT_MEASURE, get_vector_measure
from unbend.mesh.rows import equal_points
from unbend.mesh.shapes import torus
from unbend.mesh.stitch import stitched
from unbend.mesh.write import write_mesh
from unbend.signature.parameters import Parameters

EVERY: Final = 16
FORMATS: Final = ("glb", "ply", "obj")
SEAMS: Final = ("keep", "stitch")
Arrays = tuple[Floats, Indices]


def as_it_is(surface: Surface) -> Arrays:
    return surface.vertices, surface.faces.astype(np.int64)


def flat_shaded(surface: Surface) -> Arrays:
    """Split the vertices so that no two faces share one."""
    return surface.vertices[surface.faces].reshape(-1, 3), np.arange(surface.faces.size).reshape(-1, 3)


def uv_seams(surface: Surface) -> Arrays:
    """Split the vertices where the nearest axis of the faces changes, as a box projection of textures does."""
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    axis = np.abs(normals).argmax(axis=1)
    chart = 2 * axis + (normals[np.arange(len(normals)), axis] > 0)
    pairs, numbers = np.unique(6 * surface.faces.astype(np.int64) + chart[:, None], return_inverse=True)
    return surface.vertices[pairs // 6], numbers.reshape(-1, 3)


def slit(surface: Surface) -> Arrays:
    """Split the vertices along a path of edges from vertex 0 to the farthest vertex, which opens a slit."""
    way = _way(surface)
    faces, vertices = surface.faces.astype(np.int64), [*surface.vertices]
    on_the_way = set(itertools.pairwise(way))
    for before, vertex in itertools.pairwise(way[:-1]):
        fan = np.flatnonzero((surface.faces == vertex).any(axis=1)).tolist()
        side = [face for face in fan if (before, vertex) in _sides(surface.faces[face])]
        for face in side:  # `side` grows by neighbours across uncut edges
            for other in fan:
                common = set(surface.faces[face].tolist()) & set(surface.faces[other].tolist()) - {vertex}
                cut = any((end, vertex) in on_the_way or (vertex, end) in on_the_way for end in common)
                if common and not cut and other not in side:
                    side.append(other)
        faces[side] = np.where(faces[side] == vertex, len(vertices), faces[side])
        vertices.append(surface.vertices[vertex])
    return np.array(vertices), faces


def _sides(face: Indices) -> set[tuple[int, int]]:
    a, b, c = face.tolist()
    return {(a, b), (b, c), (c, a)}


def _way(surface: Surface) -> list[int]:
    tails, heads = surface.faces.ravel(), np.roll(surface.faces, -1, axis=1).ravel()
    lengths = np.linalg.norm(surface.vertices[tails] - surface.vertices[heads], axis=1)
    graph = csr_array((lengths, (tails, heads)), shape=(len(surface.vertices),) * 2)
    distances, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
    way = [int(distances.argmax())]
    while way[-1] != 0:
        way.append(int(before[way[-1]]))
    return way


WRITTEN: Final[dict[str, Callable[[Surface], Arrays]]] = {
    "indexed": as_it_is, "flat-shaded": flat_shaded, "UV seams of a box": uv_seams, "one slit": slit,
}  # fmt: skip


def main() -> None:
    paths, labels = listed("shrec11_simplified")
    measure = get_vector_measure(DEFAULT_MEASURE)
    gallery = np.stack([measure.vector(of.descriptors) for of in signatures_of(paths, Parameters())])
    asked = range(0, len(paths), EVERY)
    read: dict[tuple[str, str, str], list[Surface]] = {}
    for way, written in WRITTEN.items():
        meshes = [written(read_mesh(paths[number])) for number in asked]
        for file_type in FORMATS:
            files = [write_mesh(*mesh, file_type) for mesh in meshes]
            for seams in SEAMS:
                policy = MeshPolicy(seams=seams)
                read[way, file_type, seams] = [read_mesh(data, file_type=file_type, policy=policy) for data in files]
    vectors = _vectors([surface for surfaces in read.values() for surface in surfaces])

    def right(way: str, file_type: str, seams: str) -> str:
        hits = 0
        for number, surface in zip(asked, read[way, file_type, seams], strict=True):
            distances = measure.between(vectors[_key(surface)][None], gallery)[0]
            distances[number] = np.inf
            hits += labels[int(distances.argmin())] == labels[number]
        return f"{hits} of {len(asked)}"

    rows = [[way, seams, *(right(way, kind, seams) for kind in FORMATS)] for way in WRITTEN for seams in SEAMS]
    parts = [
        f"Correct classes of {len(asked)} shapes of shrec11_simplified, by how files split vertices and by `seams`.",
        table(["written", "`seams`", *FORMATS], rows),
        "Seconds to read a torus of a million faces as ply without joining seams, and to join them.",
        table(["written", "reading", "joining"], [_seconds(way) for way in ("indexed", "flat-shaded")]),
    ]
    write_section(BENCHMARKS / "robustness.md", "seams", "\n\n".join(parts))


def _key(surface: Surface) -> str:
    return hashlib.sha256(surface.vertices.tobytes() + surface.faces.tobytes()).hexdigest()


def _vectors(surfaces: list[Surface]) -> dict[str, Floats]:
    """Return the vectors of the distinct surfaces by key."""
    distinct = {_key(surface): (surface.vertices, surface.faces) for surface in surfaces}
    return dict(zip(distinct, in_processes(_vector, list(distinct.values())), strict=True))


def _vector(mesh: Arrays) -> Floats:
    signature = compute_signature(Surface(*mesh), threads=1)
    return get_vector_measure(DEFAULT_MEASURE).vector(signature.descriptors)


def _seconds(way: str) -> list[str]:
    mesh = WRITTEN[way](torus(columns=1000, rows=500))
    data = write_mesh(*mesh, "ply")
    surface = Surface(*mesh)
    places = equal_points(surface.vertices).astype(np.int32)
    _ = surface.edges  # reading needs them anyway
    reading = best_of(3, partial(read_mesh, data, policy=MeshPolicy(seams="keep")))
    joining = best_of(3, partial(stitched, surface, places))
    return [f"{way}, {surface.edges.boundary:,} boundary edges", f"{reading:.2f}", f"{joining:.3f}"]


if __name__ == "__main__":
    main()
