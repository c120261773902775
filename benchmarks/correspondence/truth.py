"""Correspondences between real bodies beside the truth, and beside functional maps with ZoomOut (pyFM).

    python -m benchmarks.correspondence.truth

FAUST between persons, and TOSCA within an object: for all points of the truth, the geodesic distance from the matched
point to the true point, over the square root of the area (the Princeton protocol, Kim et al. 2011). Pairs are drawn at
random from one half of the shapes, which chose no constant of `match`. Writes the section "correspondence" of
docs/benchmarks.md.
"""

from __future__ import annotations

import os
import re
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import DATA, ROOT, table, write_section
from benchmarks.retrieval.data import in_processes
from unbend import Surface, farthest_point_sampling, geodesic_distances, match, read_mesh
from unbend.threads import available_cores

PAIRS = 40
LEVELS = (0.01, 0.02, 0.03, 0.05, 0.1, 0.2)
SAMPLES = 300
TOSCA_OBJECTS = ("centaur", "dog", "michael", "victoria")
"""The objects of the reported half. Cats, David, horses and wolves chose the constants."""
BLOCK = 500


@dataclass(frozen=True)
class Truth:
    """A surface, and the vertex that is each point of the truth."""

    surface: Surface
    points: NDArray[np.int64]
    mirrored: NDArray[np.int64]


@dataclass(frozen=True)
class Outcome:
    """The errors of one map at the points of the truth, and how long it took."""

    errors: NDArray[np.float64]
    to_mirror: float
    """Mean distance to the mirror images of the true points."""
    seconds: float

    @property
    def flipped(self) -> bool:
        return self.to_mirror < float(self.errors.mean())


def main() -> None:
    texts = []
    for folder, title, target in (
        ("faust5k", "FAUST, between persons", 0.03),
        ("tosca5k", "TOSCA, within an object", 0.02),
    ):
        pairs = drawn_pairs(folder)
        grouped = [(folder, b, tuple(a for a, other in pairs if other == b)) for b in sorted({b for _, b in pairs})]
        found = [each for group in in_processes(partial(compare, by_peer=True), grouped) for each in group]
        texts.append(section(title, target, found))
    write_section(ROOT / "docs" / "benchmarks.md", "correspondence", introduction() + "\n\n" + "\n\n".join(texts))


def drawn_pairs(folder: str) -> list[tuple[str, str]]:
    """Return random pairs of the reported half: of different persons in FAUST, of the same object in TOSCA."""
    names = sorted(path.stem for path in (DATA / folder).glob("*.off"))
    if folder == "faust5k":  # the number of a shape is ten times its person's number plus its pose's
        kept = [name for name in names if int(name[-3:]) % 2 == 1]
        pairs = [(a, b) for a in kept for b in kept if a[-3:-1] != b[-3:-1]]
    else:
        kept = [name for name in names if object_of(name) in TOSCA_OBJECTS]
        pairs = [(a, b) for a in kept for b in kept if a != b and object_of(a) == object_of(b)]
    order = np.random.default_rng(2).permutation(len(pairs))
    return [pairs[i] for i in order[:PAIRS]]


def object_of(name: str) -> str:
    return re.sub(r"\d", "", name)


def read(folder: str, name: str) -> Truth:
    surface = read_mesh(DATA / folder / f"{name}.off")
    numbers = [read_numbers(DATA / folder / "corres" / f"{name}{kind}.vts") for kind in ("", ".sym")]
    if surface.vertex_map is not None:
        numbers = [surface.vertex_map[each] for each in numbers]
    return Truth(surface, *numbers)


def read_numbers(path: Path) -> NDArray[np.int64]:
    return np.loadtxt(path, dtype=np.int64) - 1


def compare(group: tuple[str, str, tuple[str, ...]], *, by_peer: bool) -> list[dict[str, Outcome | float]]:
    """Match some shapes to one, by unbend and by pyFM, on one core."""
    folder, name, others = group
    b = read(folder, name)
    between = all_distances(b)
    found = []
    match(b.surface, b.surface, samples=50, threads=1)  # loads the kernels
    for other in others:
        a = read(folder, other)
        begun = time.perf_counter()
        ours = match(a.surface, b.surface, samples=SAMPLES, threads=1)
        seconds = time.perf_counter() - begun
        corners, weights = ours.target_faces[ours.faces[a.points]], ours.barycentric[a.points]
        outcome = {"unbend": judged(b, between, corners, weights, seconds), "floor": floor(a.surface)}
        if by_peer:
            begun = time.perf_counter()
            vertices = functional_map(a.surface, b.surface)[a.points]
            seconds = time.perf_counter() - begun
            outcome["pyFM"] = judged(b, between, vertices[:, None], np.ones((len(vertices), 1)), seconds)
        found.append(outcome)
    return found


def all_distances(b: Truth) -> NDArray[np.float32]:
    """Return geodesic distances between all vertices, over the square root of the area."""
    count = len(b.surface.vertices)
    rows = np.empty((count, count), np.float32)
    for first in range(0, count, BLOCK):
        block = np.arange(first, min(first + BLOCK, count))
        rows[block] = geodesic_distances(b.surface, block, threads=1) / np.sqrt(b.surface.area)
    return rows


def judged(b: Truth, between: NDArray[np.float32], corners: NDArray, weights: NDArray, seconds: float) -> Outcome:
    """Measure a map that gives corners and their weights for each point."""

    def distances(points: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.asarray((between[points[:, None], corners] * weights).sum(axis=1), np.float64)

    return Outcome(distances(b.points), float(distances(b.mirrored).mean()), seconds)


def floor(surface: Surface) -> float:
    """Return the mean distance of vertices to the nearest sample: the error of a right map that knows no more."""
    rows = geodesic_distances(surface, farthest_point_sampling(surface, SAMPLES), threads=1)
    return float(rows.min(axis=0).mean() / np.sqrt(surface.area))


def functional_map(a: Surface, b: Surface) -> NDArray[np.int64]:
    """Return a vertex of b for each of a, by wave kernel signatures and ZoomOut, with pyFM's own weights."""
    from pyFM.functional import FunctionalMapping  # noqa: PLC0415
    from pyFM.mesh import TriMesh  # noqa: PLC0415

    theirs, ours = (TriMesh(each.vertices, each.faces) for each in (b, a))
    model = FunctionalMapping(theirs, ours)
    model.preprocess(n_descr=100, descr_type="WKS", subsample_step=5, k_process=150)
    model.fit(K=(50, 50))
    model.zoomout_refine(nit=20, step=5)
    return np.asarray(model.get_p2p(n_jobs=1))


def introduction() -> str:
    return f"""For {PAIRS} random pairs of the half of the shapes that chose no constant of `match`: distance from each matched point to the true point along the surface, over the square root of the area, at all points of the truth. A pair is flipped if its points are nearer to the mirror images of the true ones. The floor is the mean distance of vertices to the nearest of {SAMPLES} samples. Seconds a pair on one core, with all that the two surfaces need, at a load of {os.getloadavg()[0]:.0f} on {available_cores()} cores; `match` takes {SAMPLES} samples of each. pyFM: wave kernel signatures, a functional map of 50 functions with pyFM's weights, ZoomOut to 150, without landmarks."""  # noqa: E501


def section(title: str, target: float, found: list[dict[str, Outcome | float]]) -> str:
    header = [
        f"{title} (asked: at most {target})", "mean error", "median pair", "worst pair", "flipped pairs", "seconds",
        *[f"within {level}" for level in LEVELS],
    ]  # fmt: skip
    rows = [row(name, [each[name] for each in found]) for name in ("unbend", "pyFM")]
    floors = np.mean([each["floor"] for each in found])
    return f"{table(header, rows)}\n\nFloor of {SAMPLES} samples: {floors:.4f}."


def row(name: str, outcomes: list[Outcome]) -> list[str]:
    means = np.array([outcome.errors.mean() for outcome in outcomes])
    errors = np.concatenate([outcome.errors for outcome in outcomes])
    flipped = sum(outcome.flipped for outcome in outcomes)
    shares = [f"{(errors <= level).mean():.1%}" for level in LEVELS]
    figures = [f"{means.mean():.4f}", f"{np.median(means):.4f}", f"{means.max():.4f}"]
    seconds = f"{np.median([outcome.seconds for outcome in outcomes]):.1f}"
    return [name, *figures, f"{flipped} of {len(outcomes)}", seconds, *shares]


if __name__ == "__main__":
    main()
