"""The time of a signature from file to descriptors, and the share of it outside the rows of geodesic distances."""

from __future__ import annotations

import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import potpourri3d as pp3d

from benchmarks.common import DATA, in_turns, table
from benchmarks.embedding.meshes import SAMPLES, listed
from unbend import (
    Surface,
    canonical_form,
    compute_signature,
    farthest_point_sampling,
    geodesic_matrix,
    read_mesh,
)
from unbend.embedding.stress import stress

HELD_OUT = 200


def signature_table() -> str:
    paths = [listed("shrec11_simplified")[0], DATA / "single" / "human_man.obj", DATA / "single" / "bunny_hr.obj"]
    header = [
        "mesh",
        "signature, ms",
        "outside the rows, ms",
        "share outside the rows",
        "potpourri3d heat rows, ms",
        "times ours",
    ]
    return (
        f"**A whole signature**, file to descriptors, {SAMPLES} samples, default parameters, warm process, compared"
        " with the time of potpourri3d's prefactored heat method for the rows alone.\n\n"
        + table(header, [_row(path) for path in paths])
    )


def _row(path: Path) -> list[str]:
    data = path.read_bytes()
    surface = read_mesh(data)
    samples = farthest_point_sampling(surface, min(SAMPLES, len(surface.used_vertices)))
    found = in_turns({"ours": lambda: _whole(data), "heat": lambda: _heat_rows(surface, samples)})
    (seconds, outside), heat = found["ours"], found["heat"][0]
    return [
        f"{path.stem} ({len(surface.vertices):,})",
        f"{1e3 * seconds:.0f}",
        f"{1e3 * outside:.0f}",
        f"{outside / seconds:.0%}",
        f"{1e3 * heat:.0f}",
        f"{heat / seconds:.1f}",
    ]


def _whole(data: bytes) -> float:
    """Compute a signature; return the seconds outside the distance rows."""
    marks = [("reading", time.perf_counter())]
    compute_signature(read_mesh(data), threads=1, progress=lambda at: marks.append((at.stage, time.perf_counter())))
    marks.append(("end", time.perf_counter()))
    inside = sum(after - at for (stage, at), (_, after) in pairwise(marks) if stage == "geodesics")
    return marks[-1][1] - marks[0][1] - inside


def form_table() -> str:
    paths = [DATA / "tosca5k" / "cat0.off", DATA / "single" / "armadillo.obj", DATA / "single" / "bunny_hr.obj"]
    header = [
        "mesh",
        "stress of the samples",
        "stress of other vertices",
        "signature, ms",
        "canonical form in addition, ms",
    ]
    return (
        f"**Whole forms**: stress (eq. 2) of the form between {HELD_OUT} random vertices that are not samples, compared"
        " with that of the samples; and the time of placing all vertices, all threads.\n\n"
        + table(header, [_form_row(path) for path in paths])
    )


def _form_row(path: Path) -> list[str]:
    surface = read_mesh(path)
    signature = compute_signature(surface)
    found = in_turns(
        {
            "signature": lambda: compute_signature(surface),
            "form": lambda: canonical_form(surface, signature=signature),
        },
        turns=2,
    )
    others = np.setdiff1d(surface.used_vertices, signature.samples)
    chosen = np.random.default_rng(0).choice(others, HELD_OUT, replace=False)
    straight = found["form"][1].points[chosen] * signature.scale
    return [
        f"{path.stem} ({len(surface.vertices):,})",
        f"{signature.stress:.5f}",
        f"{stress(np.ascontiguousarray(straight), geodesic_matrix(surface, chosen)):.5f}",
        f"{1e3 * found['signature'][0]:.0f}",
        f"{1e3 * found['form'][0]:.0f}",
    ]


def _heat_rows(surface: Surface, samples: np.ndarray) -> None:
    solver = pp3d.MeshHeatMethodDistanceSolver(surface.vertices, surface.faces)
    for sample in samples:
        solver.compute_distance(int(sample))


if __name__ == "__main__":
    print(signature_table())
