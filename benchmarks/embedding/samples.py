"""The number of samples that `samples="auto"` chooses, and its time.

    python -m benchmarks.embedding.samples

Uses meshes of four data sets, and compares the time of a signature with `samples="auto"` to the time with 300 samples.
Writes the section "samples" of docs/benchmarks/embedding.md.
"""

from __future__ import annotations

import numpy as np

from benchmarks.common import BENCHMARKS, in_turns, table, write_section
from benchmarks.embedding.meshes import listed
from unbend import Parameters, Signature, Surface, compute_signature, read_mesh

EVERY = {"shrec11_simplified": 80, "tosca5k": 9, "faust5k": 6, "shrec07": 20}
TOLERANCES = (0.05, 0.02, 0.01)


def main() -> None:
    rows = []
    for dataset, step in EVERY.items():
        surfaces = [read_mesh(path) for path in listed(dataset)[step // 2 :: step]]
        for tolerance in TOLERANCES:
            chosen = Parameters(samples="auto", tolerance=tolerance)
            counts, ratios = zip(*(_measured(surface, chosen) for surface in surfaces), strict=True)
            rows.append([dataset, len(surfaces), tolerance, *np.percentile(counts, [0, 50, 100]).astype(int),
                         f"{np.median(ratios):.1f}"])  # fmt: skip
    write_section(
        BENCHMARKS / "embedding.md", "samples",
        "**Samples by analysis**: how many `samples=\"auto\"` takes until the spectrum moves by at most the tolerance,"
        " and the median time of a signature over that with 300 samples, in turns.\n\n"
        + table(["data set", "meshes", "tolerance", "fewest", "median", "most", "time / time with 300"], rows),
    )  # fmt: skip


def _measured(surface: Surface, chosen: Parameters) -> tuple[int, float]:
    def with_300() -> Signature:
        return compute_signature(surface, threads=1)

    def by_analysis() -> Signature:
        return compute_signature(surface, chosen, threads=1)

    found = in_turns({"300": with_300, "auto": by_analysis}, turns=2)
    return len(found["auto"][1].points), found["auto"][0] / found["300"][0]


if __name__ == "__main__":
    main()
