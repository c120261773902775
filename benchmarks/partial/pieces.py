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
from unbend.arrays import Floats
from unbend.local.signatures import LocalSignatures, local_signatures
from unbend.matching.measures.vectors import SPECTRUM
from unbend.matching.partial import profiles_of
from unbend.matching.partial.search import search_parts
from unbend.signature.signature import Signature

PER_CLASS = 8
"""Shapes of each class of SHREC'11, as in the issue that asked for parts."""

DATASETS = {"SHREC'11": "shrec11_simplified", "TOSCA": "tosca5k"}


@dataclass(frozen=True)
class Asked:
    """A surface with its local signatures and its whole signature."""

    local: LocalSignatures
    whole: Signature


def unit(surface: Surface) -> Surface:
    """Return a surface scaled to area 1, so that shapes of all classes have the same size."""
    return Surface(surface.vertices / np.sqrt(surface.area), surface.faces)


def asked(surface: Surface) -> Asked:
    return Asked(local_signatures(surface, threads=1), compute_signature(surface, threads=1))


class Wholes:
    """The wholes of one half of the classes of a data set, and pieces of them."""

    def __init__(self, dataset: str, which: int) -> None:
        paths, labels = listed(dataset)
        classes, _ = np.unique(labels, return_inverse=True)
        chosen = np.flatnonzero(half(labels, which))
        if dataset == "shrec11_simplified":
            chosen = np.concatenate([np.flatnonzero(np.array(labels) == each)[:PER_CLASS] for each in classes])
            chosen = chosen[half(labels, which)[chosen]]
        self.names = [paths[row].stem for row in chosen]
        self.labels = np.array(labels)[chosen]
        self.surfaces = [unit(read_mesh(paths[row])) for row in chosen]
        self.asked = [asked(surface) for surface in self.surfaces]
        self.profiles = [profiles_of(each.local) for each in self.asked]
        self.vectors = np.array([SPECTRUM.vector(each.whole.descriptors) for each in self.asked])

    def pieces(self, cut: str) -> list[Asked]:
        return [asked(piece(surface, cut, name)) for surface, name in zip(self.surfaces, self.names, strict=True)]

    def partial(self, query: Asked, *, any_scale: bool = False) -> Floats:
        load = partial(_load, self.asked)
        return search_parts(query.local, self.profiles, load, any_scale=any_scale).distances

    def default(self, query: Asked) -> Floats:
        return SPECTRUM.distances(SPECTRUM.vector(query.whole.descriptors), self.vectors)

    def figures(self, distances: Sequence[Floats]) -> str:
        """Return nearest class, first tier, and how often the own original comes first."""
        rows = []
        for own, row in enumerate(distances):
            first = bool((row < row[own]).sum() == 0)
            others = np.where(np.arange(len(row)) == own, np.inf, row)
            same = self.labels == self.labels[own]
            nearest = np.argsort(others, kind="stable")[: same.sum() - 1]
            rows.append((bool(same[nearest[0]]), same[nearest].mean(), first))
        nearest_class, tier, origin = np.mean(rows, axis=0)
        return f"{nearest_class:.2f}, {tier:.2f}, {origin:.2f}"


def _load(wholes: Sequence[Asked], rows: Floats) -> list[LocalSignatures]:
    return [wholes[int(row)].local for row in rows]


def measured(which: int) -> str:
    rows = []
    for title, dataset in DATASETS.items():
        wholes = Wholes(dataset, which)
        for cut in CUTS:
            pieces = wholes.pieces(cut)
            found = [
                [wholes.default(each) for each in pieces],
                [wholes.partial(each) for each in pieces],
                [wholes.partial(each, any_scale=True) for each in pieces],
            ]
            rows.append([title, cut, *(wholes.figures(each) for each in found)])
            print(rows[-1], flush=True)
        found = [[wholes.default(each) for each in wholes.asked], [wholes.partial(each) for each in wholes.asked]]
        rows.append([title, "whole", *(wholes.figures(each) for each in found), "-"])
        print(rows[-1], flush=True)
    return table(["data", "piece", "default measure", "`partial`", "`partial`, scale unknown"], rows)


def main() -> None:
    if sys.argv[1:] == ["choose"]:
        print(measured(0))
        return
    write_section(ROOT / "docs" / "benchmarks.md", "pieces", measured(1))


if __name__ == "__main__":
    main()
