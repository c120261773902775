"""Distances between isometric surfaces in every measure, compared with the error of their meshes.

    python -m benchmarks.embedding.isometric

Writes the section "isometric" of docs/benchmarks/embedding.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from itertools import combinations

import numpy as np

from benchmarks.common import BENCHMARKS, table, write_section
from unbend import Signature, Surface, compare, compute_signature
from unbend.matching.measures import MEASURES, VECTOR_MEASURES
from unbend.mesh.shapes import TUBE_POSES, bent_tube, cylinder, helicoid_catenoid, s_bend, sheet, spiral

Bending = Callable[[int], Surface]

TIMES = (1, 2, 4)
"""Resolutions: each has edges half as long as the previous one."""

INTRODUCTION = (
    "Three families of one surface bent in several ways, at three resolutions; default parameters. **Apart** is the"
    " largest distance between two bendings, in each measure that uses the form alone. **Mesh** is the largest"
    " distance of a bending from itself on a mesh of half the edge length. Each cell: apart / mesh (their ratio)."
)

OF_FORMS = [name for name in MEASURES if not name.startswith("surface")]


def families() -> dict[str, list[Bending]]:
    def bendings(*makes: Callable[..., Surface], columns: int, rows: int) -> list[Bending]:
        return [lambda k, make=make: make(columns=k * columns, rows=k * rows) for make in makes]

    return {
        "sheet: flat, cylinder, S, spiral": bendings(sheet, cylinder, s_bend, spiral, columns=20, rows=10),
        "helicoid, between, catenoid": bendings(
            *(partial(helicoid_catenoid, t) for t in (0.0, math.pi / 4, math.pi / 2)), columns=30, rows=10
        ),
        "tube: " + ", ".join(TUBE_POSES): [lambda k, pose=pose: bent_tube(pose, around=8 * k) for pose in TUBE_POSES],
    }


def main() -> None:
    parts = [INTRODUCTION]
    parts += [_family_table(family, bendings) for family, bendings in families().items()]
    parts.append(_radius_table())
    write_section(BENCHMARKS / "embedding.md", "isometric", "\n\n".join(parts))


def _family_table(family: str, bendings: list[Bending]) -> str:
    signatures = [[compute_signature(bending(times)) for bending in bendings] for times in (*TIMES, 2 * TIMES[-1])]
    rows = []
    for times, coarse, fine in zip(TIMES, signatures, signatures[1:], strict=False):
        cells = []
        for measure in OF_FORMS:
            apart = _apart(coarse, measure)
            mesh = max(compare(*pair, measure) for pair in zip(coarse, fine, strict=True))
            cells.append(f"{apart:.2g} / {mesh:.2g} ({apart / mesh:.1f})")
        rows.append([max(len(bending(times).vertices) for bending in bendings), *cells])
    return f"**{family}**:\n\n" + table(["vertices", *OF_FORMS], rows)


def _radius_table() -> str:
    shown = [name for name in OF_FORMS if name != "combined"]
    rows = []
    for radius in (0.15, 0.075, 0.0375):
        signatures = [compute_signature(bent_tube(pose, radius=radius, around=12)) for pose in TUBE_POSES]
        sizes = [np.abs(signatures[0].descriptors[name]).sum() if name in VECTOR_MEASURES else 1.0 for name in shown]
        cells = [f"{_apart(signatures, name) / size:.3f}" for name, size in zip(shown, sizes, strict=True)]
        rows.append([radius, *cells])
    return (
        "The poses of the tube are not isometric: the inner side of a bend is shorter than the outer one, by a share"
        " that falls with the radius. So the poses of thinner tubes, all of length 5, are nearer to each other. The"
        " table shows **Apart**, for vectors as a share of the straight tube's vector:\n\n"
        + table(["radius", *shown], rows)
    )


def _apart(signatures: list[Signature], measure: str) -> float:
    return max(compare(*pair, measure) for pair in combinations(signatures, 2))


if __name__ == "__main__":
    main()
