"""Which whole is a piece of: the class and the origin of pieces of SHREC'11 and TOSCA, by several measures.

python -m benchmarks.partial.pieces            # writes "pieces" and "pieces-tosca" of docs/benchmarks/pieces.md
python -m benchmarks.partial.pieces TOSCA      # writes one of them
python -m benchmarks.partial.pieces choose     # prints constants by the half that they come from
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.common import BENCHMARKS, table, write_section
from benchmarks.partial.cuts import CUTS, piece
from benchmarks.retrieval.data import half, listed
from unbend import Surface, compute_signature, read_mesh
from unbend.arrays import Floats, Singles
from unbend.local.signatures import LocalSignatures, local_signatures
from unbend.matching.classification.calibration import confidences
from unbend.matching.measures.vectors import SPECTRUM
from unbend.matching.partial import profiles_of
from unbend.matching.partial.calibration import MEMBERS, SLACK, unfamiliarity
from unbend.matching.partial.search import PartSearch, search_parts
from unbend.signature.signature import Signature

PER_CLASS = 8
"""Shapes of each class of SHREC'11, as in the issue that asked for parts."""

DATASETS = {"SHREC'11": ("shrec11_simplified", 1, 3), "TOSCA": ("tosca5k", None, 1)}
"""Folder, the half of the classes that is reported (None: all), and the step of the wholes that pieces are cut of.

Constants come from the other half of SHREC'11 alone.
"""

WHOLE = "none, a whole shape"
"""The row of whole shapes, which ask for other shapes of their class."""


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
    """The wholes of one half of the classes of a data set, or of all (None), and pieces of them."""

    def __init__(self, dataset: str, which: int | None, *, whole: bool = True) -> None:
        paths, labels = listed(dataset)
        _, apart = listed(dataset, merged=False)
        wanted = np.ones(len(labels), bool) if which is None else half(labels, which)
        if dataset == "shrec11_simplified":
            first = [np.flatnonzero(np.array(labels) == each)[:PER_CLASS] for each in np.unique(labels)]
            wanted &= np.isin(np.arange(len(labels)), np.concatenate(first))
        chosen = np.flatnonzero(wanted)
        chosen = chosen[np.argsort(np.array(labels)[chosen], kind="stable")]
        self.names = [paths[row].stem for row in chosen]
        self.labels = np.array(labels)[chosen]
        self.apart = np.array(apart)[chosen]
        self.surfaces = [unit(read_mesh(paths[row])) for row in chosen]
        self.asked = [asked(surface, whole=whole) for surface in self.surfaces]
        self.profiles = [profiles_of(each.local) for each in self.asked]
        self.vectors = np.array([_vector(each) for each in self.asked if each.whole])

    def partial(self, query: LocalSignatures, *, any_scale: bool = False) -> PartSearch:
        load = partial(_load, self.asked)
        return search_parts(query, self.profiles, load, any_scale=any_scale, threads=1)

    def default(self, query: Asked) -> Floats:
        return SPECTRUM.distances(_vector(query), self.vectors)

    def figures(self, distances: Sequence[Floats], step: int, labels: Sequence[str]) -> str:
        """Return nearest class, first tier, and how often the own original comes first.

        `distances` are those of the pieces of every `step`-th whole.
        """
        rows = []
        for own, row in zip(range(0, len(self.names), step), distances, strict=True):
            first = bool((row < row[own]).sum() == 0)
            others = np.where(np.arange(len(row)) == own, np.inf, row)
            same = labels == labels[own]
            nearest = np.argsort(others, kind="stable")[: same.sum() - 1]
            rows.append((bool(same[nearest[0]]), same[nearest].mean(), first))
        nearest_class, tier, origin = np.mean(rows, axis=0)
        return f"{nearest_class:.2f}, {tier:.2f}, {origin:.2f}"

    def answer(self, own: int, query: LocalSignatures, found: PartSearch, labels: Sequence[str]) -> Answer:
        """Return what a library without row `own` says about its piece."""
        distances = np.where(np.arange(len(self.names)) == own, np.inf, found.distances)
        by_class = {label: float(distances[labels == label].min()) for label in np.unique(labels)}
        strange = np.where(labels == labels[own], np.inf, distances)
        return Answer(
            self._unfamiliarity(query, found, distances, labels),
            self._unfamiliarity(query, found, strange, labels),
            by_class.pop(labels[own]),
            tuple(by_class.values()),
        )

    def _unfamiliarity(
        self, query: LocalSignatures, found: PartSearch, distances: Floats, labels: Sequence[str]
    ) -> float:
        best = int(distances.argmin())
        if best not in found.comparisons:  # no circle of the piece fits
            return np.inf
        order = np.argsort(distances, kind="stable")
        members = [row for row in order if labels[row] == labels[best] and row != best and np.isfinite(distances[row])]
        ratio = unfamiliarity(
            query,
            found.comparisons[best],
            self.asked[best].local,
            [self.asked[row].local for row in members[:MEMBERS]],
            float(distances[labels != labels[best]].min()),
        )
        return np.nan if ratio is None else ratio


@dataclass(frozen=True)
class Answer:
    """Unfamiliarity of a piece in a library with and without its class, and its distances from classes."""

    familiar: float
    strange: float
    right: float
    others: tuple[float, ...]


def accepted(answers: Sequence[Answer], slack: float) -> tuple[float, float]:
    """Return the share of pieces accepted in a library with their class, and in one without it.

    Nothing is known of classes with a single member.
    """
    ratios = np.array([(each.familiar, each.strange) for each in answers])
    familiar, strange = (float((each[~np.isnan(each)] <= slack).mean()) for each in ratios.T)
    return familiar, strange


def likelihood(answers: Sequence[Answer], exponent: float) -> float:
    """Return the mean logarithm of the right classes' confidences."""
    rows = [confidences(np.array([each.right, *each.others]), exponent)[0] for each in answers]
    return float(np.log(np.maximum(rows, 1e-9)).mean())


def _vector(query: Asked) -> Singles:
    assert query.whole is not None
    return SPECTRUM.vector(query.whole.descriptors)


def _load(wholes: Sequence[Asked], rows: Floats) -> list[LocalSignatures]:
    return [wholes[int(row)].local for row in rows]


def in_another_unit(surface: Surface, name: str) -> Surface:
    """Return a surface scaled by a random factor between a half and two, the same on every run."""
    random = np.random.default_rng(zlib.crc32(f"unit/{name}".encode()))
    return Surface(surface.vertices * 2.0 ** random.uniform(-1, 1), surface.faces)


def measured(title: str) -> str:
    rows = []
    dataset, which, step = DATASETS[title]
    wholes = Wholes(dataset, which)
    labellings = {title: wholes.labels}
    if (wholes.labels != wholes.apart).any():
        labellings[f"{title}, each person a class"] = wholes.apart
    owns = range(0, len(wholes.names), step)
    for cut in (*CUTS, WHOLE):
        default, known, unknown = [], [], []
        locals_ = []
        for own in owns:
            surface, query = wholes.surfaces[own], wholes.asked[own]
            if cut != WHOLE:
                surface = piece(surface, cut, wholes.names[own])
                query = asked(surface)
            scaled = local_signatures(in_another_unit(surface, wholes.names[own]), threads=1)
            locals_.append(query.local)
            default.append(wholes.default(query))
            known.append(wholes.partial(query.local))
            unknown.append(wholes.partial(scaled, any_scale=True).distances)
        for name, labels in labellings.items():
            answers = [wholes.answer(own, *each, labels) for own, *each in zip(owns, locals_, known, strict=True)]
            figures = [
                wholes.figures(each, step, labels) for each in (default, [found.distances for found in known], unknown)
            ]
            shares = ", ".join(f"{share:.2f}" for share in accepted(answers, SLACK))
            rows.append([f"{name}, {len(owns)} pieces", cut, *figures, shares])
            print(rows[-1], flush=True)
    header = ["data", "piece", "`spectrum`, the default", "`partial`", "`partial_any_scale`", "known, with and without"]
    return table(header, rows)


NOTES = """\
Pieces of shapes of area 1, each asked of all wholes: {per} shapes of each class of half of the classes of SHREC'11, and
all of TOSCA. In each cell: the share of pieces whose nearest whole, apart from their own, has their class; the first
tier; the share of pieces whose own whole comes first. For `partial_any_scale` each piece was scaled by a random factor
between a half and two. The last column is the share of pieces that `partial` calls known in a library with their class,
and in one without it. The persons of TOSCA are one class, or each person is a class. The constants of this version were
chosen on the other half of the classes of SHREC'11 (`python -m benchmarks.partial.pieces choose` prints those of the
last column). Earlier constants were chosen on cats, dogs and persons of TOSCA, too.
"""


def choose() -> None:
    """Print constants by pieces of the other half of SHREC'11: of every second shape."""
    found: list[Answer] = []
    wholes = Wholes("shrec11_simplified", 0, whole=False)
    for cut in CUTS:
        for own in range(0, len(wholes.names), 2):
            query = local_signatures(piece(wholes.surfaces[own], cut, wholes.names[own]), threads=1)
            found.append(wholes.answer(own, query, wholes.partial(query), wholes.labels))
    slack = max(np.arange(0.5, 2.0, 0.01), key=lambda each: np.subtract(*accepted(found, each)))
    exponent = max(np.arange(1.0, 150.0, 0.1), key=lambda each: likelihood(found, each))
    print(f"SLACK {slack:.2f}, accepted with and without the class: {accepted(found, slack)}; EXPONENT {exponent:.1f}")


SECTIONS = {"SHREC'11": "pieces", "TOSCA": "pieces-tosca"}


def main() -> None:
    if sys.argv[1:] == ["choose"]:
        choose()
        return
    for title in sys.argv[1:] or DATASETS:
        notes = NOTES.format(per=PER_CLASS) + "\n" if title == "SHREC'11" else ""
        write_section(BENCHMARKS / "pieces.md", SECTIONS[title], f"{notes}{measured(title)}")


if __name__ == "__main__":
    main()
