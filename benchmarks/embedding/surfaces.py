"""How often the signature's triangles keep the surface's topology."""

from __future__ import annotations

import numpy as np

from benchmarks.common import table
from benchmarks.embedding.meshes import listed
from unbend import Parameters, Surface, compute_signature, read_mesh
from unbend.errors import MeshError
from unbend.mesh.census import take_census

STEPS = {"single": 1, "shrec11_simplified": 8, "tosca5k": 2, "faust5k": 2}
SIZES = (100, 300)


def surface_table() -> str:
    rows = [
        [f"{dataset}, every {step}.", *(_kept(dataset, step, size) for size in SIZES)]
        for dataset, step in STEPS.items()
    ]
    return (
        "**Signature surfaces**: the number of meshes whose triangles between samples have the same Euler"
        " characteristic, boundary loops, non-manifold edges and vertices, and misoriented edges as the mesh; and"
        " the mean quality of these triangles (4 root 3 area over the sum of squared sides, in the signature in three"
        " dimensions).\n\n" + table(["data set", *(f"{size} samples" for size in SIZES)], rows)
    )


def _kept(dataset: str, step: int, size: int) -> str:
    kept, qualities, count = 0, [], 0
    for path in listed(dataset)[::step]:
        surface = read_mesh(path)
        try:
            signature = compute_signature(surface, Parameters(samples=size))
        except MeshError:
            continue
        count += 1
        kept += _topology(Surface(surface.vertices[signature.samples], signature.faces)) == _topology(surface)
        qualities.append(_quality(signature.points, signature.faces))
    return f"{kept} of {count}, {np.mean(qualities):.2f}"


def _topology(surface: Surface) -> tuple[int, ...]:
    census = take_census(surface)
    characteristic = len(surface.used_vertices) - len(surface.edges.starts) + len(surface.faces)
    return (
        characteristic,
        census.boundary_loops,
        census.nonmanifold_edges,
        census.nonmanifold_vertices,
        census.misoriented_edges,
    )


def _quality(points: np.ndarray, faces: np.ndarray) -> float:
    surface = Surface(points, faces)
    a, b, c = points[faces].transpose(1, 0, 2)
    squares = ((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2).sum(axis=1)
    return float(np.mean(4 * np.sqrt(3) * surface.face_areas / squares))
