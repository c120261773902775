"""Errors of `match` for pieces of real shapes with known origin, matched to wholes.

Constants were chosen on the other half of the shapes. One thread. Writes the section "correspondence-parts" of
docs/benchmarks/correspondence.md.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.common import BENCHMARKS, table, write_section
from benchmarks.correspondence.data import DATASETS, Subject, distances_to, pairs, same_person
from benchmarks.partial.cuts import CUTS, piece
from unbend import Surface, match
from unbend.arrays import Indices, positions_of
from unbend.correspondence.correspondence import Correspondence

PAIRS: Final = int(os.environ.get("PAIRS", "20"))
HALF: Final = os.environ.get("HALF", "report")
EVERY: Final = 5
"""Only each so many of the 5,000 true points is measured."""

LIMIT: Final = 0.05


@dataclass(frozen=True, eq=False)
class Outcome:
    """The errors of one pair."""

    cut: str
    error: float
    flipped: bool
    trusted: float
    """Mean error of the half of the points with the highest confidence."""
    seconds: float
    found: Correspondence


def settings() -> dict[str, list[tuple[Subject, Subject]]]:
    """Return pairs of the shape that is cut and the whole."""
    faust, tosca = (pairs(dataset, HALF, PAIRS) for dataset in DATASETS)
    return {
        "TOSCA, its own whole": [(a, a) for a, _ in tosca],
        "TOSCA, another pose": tosca,
        "FAUST, its own whole": [(a, a) for a, _ in faust],
        "FAUST, another pose of the person": same_person(HALF, PAIRS),
        "FAUST, another person": faust,
    }


def kept_vertices(whole: Surface, part: Surface) -> Indices:
    """Return the vertex of the whole of each vertex of a piece, which has the same coordinates."""
    places = {tuple(each): number for number, each in enumerate(whole.vertices.tolist())}
    return np.array([places[tuple(each)] for each in part.vertices.tolist()])


def outcome(a: Subject, b: Subject, cut: str) -> Outcome:
    part = piece(a.surface, cut, a.name)
    start = time.process_time()
    found = match(part, b.surface, threads=1)
    seconds = time.process_time() - start
    place = positions_of(kept_vertices(a.surface, part), len(a.surface.vertices))
    rows, row_of = distances_to(b, EVERY)

    def errors(points: Indices) -> tuple[Indices, Indices]:
        mine = place[points[::EVERY]]
        inside = mine >= 0
        return rows[row_of[inside], found.vertices[mine[inside]]], mine[inside]

    right, vertices = errors(a.points)
    mirrored, _ = errors(a.mirrored)
    here = found.confidence[vertices]
    trusted = float(right[here >= np.median(here)].mean())
    error = float(right.mean())
    flipped = bool(len(mirrored) and mirrored.mean() < error)
    print(a.name, b.name, cut, f"{error:.4f} {'flipped' if flipped else ''} {seconds:.1f} s", flush=True)
    return Outcome(cut, error, flipped, trusted, seconds, found)


def row(name: str, found: list[Outcome]) -> list[object]:
    errors = np.array([one.error for one in found])
    clear = [one.error for one in found if not one.found.ambiguous]
    return [
        name, len(found), f"{errors.mean():.4f}", f"{np.median(errors):.4f}", f"{errors.max():.3f}",
        f"{(errors <= LIMIT).mean():.0%}", f"{np.mean([one.trusted for one in found]):.4f}",
        sum(one.flipped for one in found), len(found) - len(clear), f"{np.mean(clear):.4f}",
        f"{np.median([one.seconds for one in found]):.1f} s",
    ]  # fmt: skip


def main() -> None:
    cuts, by_setting = list(CUTS), {}
    for name, listed in settings().items():
        outcome(*listed[0], cuts[0])  # compile
        by_setting[name] = [outcome(a, b, cuts[number % len(cuts)]) for number, (a, b) in enumerate(listed)]
    every = [one for name, found in by_setting.items() if "own" not in name for one in found]
    by_cut = {cut: [one for one in every if one.cut == cut] for cut in cuts}
    header = ["", "pairs", "mean", "median pair", "worst pair", f"at most {LIMIT}", "trusted", "flipped", "ambiguous",
              "mean of others", "time"]  # fmt: skip
    text = (
        "A piece of one mesh is matched to a whole. The error is the geodesic distance from the true point, over the "
        "square root of the area of the whole, at each fifth of the 5,000 true points that the piece has. The cuts "
        "take turns. Constants were chosen on other meshes: FAUST's of even number, and TOSCA's cat, david, horse and "
        "wolf. "
        "**At most .05**: share of the pairs. **Ambiguous**: the result says so; **mean of others**: without these. "
        "**Trusted**: mean error of the half of the points with the highest confidence. "
        "**Flipped**: nearer to the mirror image of the truth. Time: of one processor, both surfaces from "
        "mesh to match, at 300 samples.\n\n"
        + table(header, [row(name, found) for name, found in by_setting.items()])
        + "\n\nBy cut, without own wholes:\n\n"
        + table(header, [row(name, found) for name, found in by_cut.items()])
    )
    if HALF == "report":
        write_section(BENCHMARKS / "correspondence.md", "correspondence-parts", text)
    else:
        print(text)


if __name__ == "__main__":
    main()
