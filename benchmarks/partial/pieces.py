"""Which whole is a piece of: the class and the origin of pieces of SHREC'11 and TOSCA, by several measures.

python -m benchmarks.partial.pieces            # writes the section "pieces" of docs/benchmarks.md
python -m benchmarks.partial.pieces choose     # prints the same for the half that constants come from
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.common import ROOT, table, write_section
from benchmarks.partial.cuts import CUTS, piece
from benchmarks.retrieval.data import half, listed
from unbend import Surface, compute_signature, read_mesh
from unbend.arrays import Floats, Singles
from unbend.local.signatures import LocalSignatures, local_signatures
from unbend.matching.classification.calibration import confidences
from unbend.matching.measures.vectors import SPECTRUM
from unbend.matching.partial import profiles_of
from unbend.matching.partial.calibration import SLACK, unfamiliarity
from unbend.matching.partial.search import PartSearch, search_parts
from unbend.signature.signature import Signature

PER_CLASS = 8
"""Shapes of each class of SHREC'11, as in the issue that asked for parts."""

STEP = 3
"""Pieces are cut of every third whole, so that the script takes minutes."""

DATASETS = {"SHREC'11": "shrec11_simplified", "TOSCA": "tosca5k"}


@dataclass(frozen=True)
class Asked:
    """A surface with its local signatures and its whole signature."""

    local: LocalSignatures
    whole: Signature | None


def unit(surface: Surface) -> Surface:
    """Return a surface scaled to area 1, so that shapes of all classes have the same size."""
    return Surface(surface.vertices / np.sqrt(surface.area), surface.faces)


def asked(surface: Surface, *, whole: bool = True) -> Asked:
    return Asked(local_signatures(surface, threads=1), compute_signature(surface, threads=1) if whole else None)


class Wholes:
    """The wholes of one half of the classes of a data set, and pieces of them."""

    def __init__(self, dataset: str, which: int, *, whole: bool = True) -> None:
        paths, labels = listed(dataset)
        classes, _ = np.unique(labels, return_inverse=True)
        chosen = np.flatnonzero(half(labels, which))
        if dataset == "shrec11_simplified":
            chosen = np.concatenate([np.flatnonzero(np.array(labels) == each)[:PER_CLASS] for each in classes])
            chosen = chosen[half(labels, which)[chosen]]
        self.names = [paths[row].stem for row in chosen]
        self.labels = np.array(labels)[chosen]
        self.surfaces = [unit(read_mesh(paths[row])) for row in chosen]
        self.asked = [asked(surface, whole=whole) for surface in self.surfaces]
        self.profiles = [profiles_of(each.local) for each in self.asked]
        self.vectors = np.array([_vector(each) for each in self.asked if each.whole])

    def pieces(self, cut: str) -> list[Asked]:
        chosen = zip(self.surfaces[::STEP], self.names[::STEP], strict=True)
        return [asked(piece(surface, cut, name)) for surface, name in chosen]

    def partial(self, query: Asked, *, any_scale: bool = False) -> PartSearch:
        load = partial(_load, self.asked)
        return search_parts(query.local, self.profiles, load, any_scale=any_scale)

    def default(self, query: Asked) -> Floats:
        return SPECTRUM.distances(_vector(query), self.vectors)

    def figures(self, distances: Sequence[Floats], step: int = 1) -> str:
        """Return nearest class, first tier, and how often the own original comes first.

        `distances` are those of the pieces of every `step`-th whole.
        """
        rows = []
        for own, row in zip(range(0, len(self.names), step), distances, strict=True):
            first = bool((row < row[own]).sum() == 0)
            others = np.where(np.arange(len(row)) == own, np.inf, row)
            same = self.labels == self.labels[own]
            nearest = np.argsort(others, kind="stable")[: same.sum() - 1]
            rows.append((bool(same[nearest[0]]), same[nearest].mean(), first))
        nearest_class, tier, origin = np.mean(rows, axis=0)
        return f"{nearest_class:.2f}, {tier:.2f}, {origin:.2f}"

    def answer(self, own: int, query: Asked, found: PartSearch) -> Answer:
        """Return what a library without row `own` says about its piece."""
        distances = np.where(np.arange(len(self.names)) == own, np.inf, found.distances)
        by_class = {label: float(distances[self.labels == label].min()) for label in np.unique(self.labels)}
        strange = np.where(self.labels == self.labels[own], np.inf, distances)
        return Answer(
            self._unfamiliarity(query, found, distances),
            self._unfamiliarity(query, found, strange),
            by_class.pop(self.labels[own]),
            tuple(by_class.values()),
        )

    def _unfamiliarity(self, query: Asked, found: PartSearch, distances: Floats) -> float:
        best = int(distances.argmin())
        if best not in found.comparisons:  # no circle of the piece fits
            return np.inf
        order = np.argsort(distances, kind="stable")
        others = [row for row in order if self.labels[row] == self.labels[best] and row != best]
        members = [self.profiles[row] for row in others if np.isfinite(distances[row])]
        ratio = unfamiliarity(
            profiles_of(query.local),
            float(found.scanned[best]),
            found.comparisons[best],
            self.profiles[best],
            members,
        )
        assert ratio is not None
        return ratio


@dataclass(frozen=True)
class Answer:
    """Unfamiliarity of a piece in a library with and without its class, and its distances from classes."""

    familiar: float
    strange: float
    right: float
    others: tuple[float, ...]


def accepted(answers: Sequence[Answer], slack: float) -> tuple[float, float]:
    """Return the share of pieces accepted in a library with their class, and in one without it."""
    return (
        float(np.mean([each.familiar <= slack for each in answers])),
        float(np.mean([each.strange <= slack for each in answers])),
    )


def likelihood(answers: Sequence[Answer], exponent: float) -> float:
    """Return the mean logarithm of the right classes' confidences."""
    rows = [confidences(np.array([each.right, *each.others]), exponent)[0] for each in answers]
    return float(np.log(np.maximum(rows, 1e-9)).mean())


def _vector(query: Asked) -> Singles:
    assert query.whole is not None
    return SPECTRUM.vector(query.whole.descriptors)


def _load(wholes: Sequence[Asked], rows: Floats) -> list[LocalSignatures]:
    return [wholes[int(row)].local for row in rows]


def measured(which: int) -> str:
    rows = []
    for title, dataset in DATASETS.items():
        wholes = Wholes(dataset, which)
        for cut in CUTS:
            pieces = wholes.pieces(cut)
            found = [wholes.partial(each) for each in pieces]
            known = [each.distances for each in found]
            unknown = [wholes.partial(each, any_scale=True).distances for each in pieces]
            answers = [wholes.answer(own * STEP, *pair) for own, pair in enumerate(zip(pieces, found, strict=True))]
            with_class, without = accepted(answers, SLACK)
            rows.append(
                [
                    f"{title}, {len(pieces)} pieces",
                    cut,
                    wholes.figures([wholes.default(each) for each in pieces], STEP),
                    wholes.figures(known, STEP),
                    wholes.figures(unknown, STEP),
                    f"{with_class:.2f}, {without:.2f}",
                ]
            )
            print(rows[-1], flush=True)
    header = ["data", "piece", "`spectrum`, the default", "`partial`", "`partial_any_scale`", "known, with and without"]
    return table(header, rows)


NOTES = """\
Pieces of shapes of area 1, each asked of all wholes of {classes} of the classes, {per} shapes of each class of SHREC'11
and all of TOSCA, whose persons are one class. In each cell: the share of pieces whose nearest whole, apart from their
own, has their class; the first tier; the share of pieces whose own whole comes first. The last column is the share of
pieces that `partial` calls known in a library with their class, and in one without it. Pieces were cut of every third
whole, which leaves few of TOSCA. The constants were chosen on the other half of the classes
(`python -m benchmarks.partial.pieces`).
"""


def choose() -> None:
    """Print the constants by small discs of the other half of the classes: of every third shape of SHREC'11."""
    found: list[Answer] = []
    for dataset, step in (("shrec11_simplified", 3), ("tosca5k", 1)):
        wholes = Wholes(dataset, 0, whole=False)
        for cut in ("disc, .45", "disc, .30"):
            for own in range(0, len(wholes.names), step):
                query = Asked(local_signatures(piece(wholes.surfaces[own], cut, wholes.names[own]), threads=1), None)
                found.append(wholes.answer(own, query, wholes.partial(query)))
    slack = max(np.arange(0.6, 3.0, 0.01), key=lambda each: np.subtract(*accepted(found, each)))
    exponent = max(np.arange(1.0, 60.0, 0.1), key=lambda each: likelihood(found, each))
    print(f"SLACK {slack:.2f}, accepted with and without the class: {accepted(found, slack)}; EXPONENT {exponent:.1f}")


def main() -> None:
    if sys.argv[1:] == ["choose"]:
        choose()
        return
    text = measured(1)
    notes = NOTES.format(classes="half", per=PER_CLASS)
    write_section(ROOT / "docs" / "benchmarks.md", "pieces", f"{notes}\n{text}")


if __name__ == "__main__":
    main()
