"""Section 5 of the paper alone: curvature extrema, geodesic circles around them, and moments of their signatures.

python -m benchmarks.partial.paper            # writes the section "pieces-paper" of docs/benchmarks/pieces.md
"""

from __future__ import annotations

import numpy as np

from benchmarks.common import BENCHMARKS, table, write_section
from benchmarks.partial.cuts import CUTS, piece
from benchmarks.partial.pieces import DATASETS, Wholes
from unbend import Surface, compute_signature, geodesic_distances
from unbend.arrays import Floats
from unbend.errors import MeshGeometryError
from unbend.local.key_points import key_points
from unbend.local.refined import refined
from unbend.local.signatures import LocalSignatures, local_signatures
from unbend.matching.partial.profiles import profiles_of
from unbend.mesh.components import largest_component
from unbend.signature.parameters import Parameters

RADIUS = 0.2
"""Radius of the circles, over the square root of the whole's area, 1."""

SAMPLES = Parameters(samples=80)


def circles(surface: Surface, local: LocalSignatures) -> Floats:
    """Return the moments of the surface within a circle around each key point, (k, 14); without one, of all."""
    fine = refined(surface)
    chosen = key_points(local)
    chosen = chosen if len(chosen) else profiles_of(local).chosen[:1]
    found = []
    for place in local.places[chosen]:
        centre = int(np.linalg.norm(fine.vertices - place, axis=1).argmin())
        distances = geodesic_distances(fine, centre, threads=1)[0]
        inside = Surface(fine.vertices, fine.faces[(distances[fine.faces] < RADIUS).all(axis=1)])
        faces, _, _ = largest_component(inside)
        try:
            found.append(compute_signature(Surface(fine.vertices, faces), SAMPLES, threads=1).moments)
        except MeshGeometryError:
            continue
    return np.array(found) if found else compute_signature(surface, SAMPLES, threads=1).moments[None]


def distance(query: Floats, shape: Floats) -> float:
    """Return the mean over a piece's circles of the squared distance to the most similar circle (the paper's D_M)."""
    return float((((query[:, None] - shape[None]) ** 2).sum(axis=2)).min(axis=1).mean())


def main() -> None:
    dataset, which, step = DATASETS["SHREC'11"]
    wholes = Wholes(dataset, which, whole=False)
    known = [circles(surface, each.local) for surface, each in zip(wholes.surfaces, wholes.asked, strict=True)]
    rows = []
    for cut in CUTS:
        found = []
        for surface, name in zip(wholes.surfaces[::step], wholes.names[::step], strict=True):
            part = piece(surface, cut, name)
            query = circles(part, local_signatures(part, threads=1))
            found.append(np.array([distance(query, shape) for shape in known]))
        rows.append([f"SHREC'11, {len(found)} pieces", cut, wholes.figures(found, step, wholes.labels)])
        print(rows[-1], flush=True)
    text = table(["data", "piece", "the paper's way: curvature extrema, circles, moments"], rows)
    write_section(BENCHMARKS / "pieces.md", "pieces-paper", text)


if __name__ == "__main__":
    main()
