"""The contribution of each part of `match`, on the pairs on which its constants were chosen.

Takes five minutes. Writes the section "correspondence-choice" of docs/benchmarks/correspondence.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final
from unittest.mock import patch

import numpy as np

from benchmarks.common import BENCHMARKS, table, write_section
from benchmarks.correspondence.data import DATASETS, errors, pairs
from unbend import match

PAIRS: Final = 12


@contextmanager
def _without(part: str) -> Iterator[dict[str, Any]]:
    """Leave out a part of `match`; yield its arguments."""
    growth, features = (sys.modules[f"unbend.correspondence.{name}"] for name in ("growth", "features"))
    if part == "the orientation of the triangles":
        yield {"orientation": "any"}
    elif part == "curvature":
        with patch.object(features, "curvatures", lambda surface, _sign: np.zeros((len(surface.vertices), 4))):
            yield {}
    elif part == "weights by misfit":
        with patch.object(growth, "_misfit", lambda *_: np.float32(0.0)):
            yield {}
    else:
        yield {}


def main() -> None:
    rows = []
    for part in ("nothing", "weights by misfit", "curvature", "the orientation of the triangles"):
        cells: list[object] = [part]
        for dataset in DATASETS:
            means, flipped = [], 0
            for a, b in pairs(dataset, "choice", PAIRS):
                with _without(part) as options:
                    found = match(a.surface, b.surface, threads=1, **options)
                right, mirrored = errors(a, b, found.vertices, every=10)
                means.append(min(right.mean(), mirrored.mean()))
                flipped += bool(mirrored.mean() < right.mean())
            cells += [f"{np.mean(means):.4f}", f"{flipped} of {PAIRS}"]
            print(part, cells, flush=True)
        rows.append(cells)
    text = (
        "On the meshes on which constants were chosen: mean error from the truth or from its mirror image, whichever "
        "is nearer, and how often the mirror image was.\n\n"
        + table(["left out", *(f"{name}{more}" for name in DATASETS for more in ("", ": flipped"))], rows)
    )
    write_section(BENCHMARKS / "correspondence.md", "correspondence-choice", text)


if __name__ == "__main__":
    main()
