"""Errors of `match` on real shapes with known correspondence, beside functional maps with ZoomOut by pyFM.

Constants were chosen on the other half of the shapes. One thread; takes a quarter of an hour. pyFM is measured if it is
installed (`pip install pyfmaps`). Writes the section "correspondence" of docs/benchmarks/correspondence.md.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.common import BENCHMARKS, table, write_section
from benchmarks.correspondence.data import DATASETS, Subject, errors, floor, pairs
from unbend import match
from unbend.arrays import Floats, Indices, Singles

PAIRS: Final = int(os.environ.get("PAIRS", "30"))
PEER_PAIRS: Final = 10
LEVELS: Final = (0.01, 0.02, 0.03, 0.05, 0.1, 0.2)

Method = Callable[[Subject, Subject], tuple[Indices, Floats | None]]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The errors of one pair."""

    errors: Singles
    flipped: bool
    seconds: float
    trusted: float
    """Mean error of the half of the points with the highest confidence."""


def ours(a: Subject, b: Subject) -> tuple[Indices, Floats | None]:
    found = match(a.surface, b.surface, threads=1)
    return found.vertices, found.confidence


def zoomout(a: Subject, b: Subject) -> tuple[Indices, Floats | None]:
    """Functional maps from wave kernel signatures with the orientation term, then ZoomOut, as pyFM's examples do."""
    from pyFM.functional import FunctionalMapping  # noqa: PLC0415
    from pyFM.mesh import TriMesh  # noqa: PLC0415

    one, other = (TriMesh(each.surface.vertices, each.surface.faces, area_normalize=True) for each in (b, a))
    model = FunctionalMapping(one, other)
    model.preprocess(n_descr=100, descr_type="WKS", subsample_step=5, k_process=110)
    model.fit(K=(30, 30), w_descr=1.0, w_lap=1e-2, w_dcomm=1e-1, w_orient=1e-1)
    return np.asarray(model.get_p2p(FM=model.zoomout_refine(nit=16, step=5, subsample=1000))), None


def outcomes(method: Method, listed: list[tuple[Subject, Subject]]) -> list[Outcome]:
    found = []
    for a, b in listed:
        start = time.perf_counter()
        images, confidence = method(a, b)
        seconds = time.perf_counter() - start
        right, mirrored = errors(a, b, images)
        trusted = np.nan
        if confidence is not None:
            here = confidence[a.points]
            trusted = float(right[here >= np.median(here)].mean())
        found.append(Outcome(right, mirrored.mean() < right.mean(), seconds, trusted))
        print(a.name, b.name, f"{right.mean():.4f} {mirrored.mean():.4f} {seconds:.2f} s", flush=True)
    return found


def row(name: str, found: list[Outcome]) -> list[object]:
    means = np.array([one.errors.mean() for one in found])
    return [
        name, len(found), f"{means.mean():.4f}", f"{np.median(means):.4f}", f"{means.max():.3f}",
        f"{np.mean([one.trusted for one in found]):.4f}".replace("nan", "-"), sum(one.flipped for one in found),
        f"{np.median([one.seconds for one in found]):.1f} s",
    ]  # fmt: skip


def curve(name: str, found: list[Outcome]) -> list[object]:
    every = np.concatenate([one.errors for one in found])
    return [name, *(f"{(every <= level).mean():.0%}" for level in LEVELS)]


def is_installed() -> bool:
    try:
        import pyFM  # noqa: F401, PLC0415
    except ImportError:
        return False
    return True


def main() -> None:
    rows, curves, floors = [], [], []
    for dataset in DATASETS:
        listed = pairs(dataset, "report", PAIRS)
        match(listed[0][0].surface, listed[0][1].surface, threads=1)  # compile
        named = {"unbend": outcomes(ours, listed)}
        if is_installed():
            named[f"unbend, the first {PEER_PAIRS}"] = named["unbend"][:PEER_PAIRS]
            named[f"pyFM, the first {PEER_PAIRS}"] = outcomes(zoomout, listed[:PEER_PAIRS])
        rows += [row(f"{dataset}: {name}", found) for name, found in named.items()]
        curves += [curve(f"{dataset}: {name}", found) for name, found in named.items()]
        floors.append(f"{np.mean([floor(a, b) for a, b in listed[:PEER_PAIRS]]):.4f} ({dataset})")
    text = (
        "Each vertex of one mesh is matched to another, and the error is the geodesic distance from the true "
        "point, over the square root of the area, at all 5,000 true points (the protocol of Kim, Lipman & Funkhouser "
        "2011). "
        "Constants were chosen on other meshes: FAUST's of even number, and TOSCA's cat, david, horse and wolf. "
        "**Flipped**: nearer to the mirror image of the truth. **Trusted**: mean error of the half of the points with "
        "the highest confidence. Time: one thread, both surfaces from mesh to match, with samples and distances, at "
        "300 samples.\n\n"
        + table(["", "pairs", "mean", "median pair", "worst pair", "trusted", "flipped", "time"], rows)
        + "\n\n**Points with at most this error:**\n\n"
        + table(["", *map(str, LEVELS)], curves)
        + "\n\nThe floor, because several true points share a vertex: a mean of "
        + ", ".join(floors)
        + "."
    )
    write_section(BENCHMARKS / "correspondence.md", "correspondence", text)


if __name__ == "__main__":
    main()
