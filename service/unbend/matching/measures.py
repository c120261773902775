"""Measures: how far two signatures are apart. Each compares the descriptor of its own name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.errors import ParameterError
from unbend.signature.signature import Signature


@dataclass(frozen=True)
class Measure:
    """A distance between descriptor vectors: the sum of absolute differences (L1).

    It is symmetric, zero between equal vectors, and depends on nothing but the two. L1 is less swayed by a single
    large difference than L2.
    """

    name: str
    invariances: tuple[str, ...]
    reference: str

    def distances(self, query: Floats, gallery: Floats) -> Floats:
        """Return the distance from `query` (d,) to each row of `gallery` (n, d), as (n,)."""
        return np.asarray(np.abs(gallery - query).sum(axis=1))

    def matrix(self, vectors: Floats) -> Floats:
        """Return all distances between the rows of `vectors` (n, d), as (n, n)."""
        return np.stack([self.distances(vector, vectors) for vector in vectors])


MEASURES: Final[Mapping[str, Measure]] = MappingProxyType(
    {
        measure.name: measure
        for measure in (
            Measure(
                "spectrum",
                ("bending", "rotation", "reflection", "scale"),
                "Smeets et al. 2012 (SD-GDM): eigenvalues of the geodesic distance matrix",
            ),
            Measure(
                "moments",
                ("bending", "rotation", "reflection", "scale"),
                "Elad & Kimmel 2003, section 2.3, after Tal & Elad: moments of the signature surface",
            ),
            Measure(
                "distribution",
                ("bending", "rotation", "reflection", "scale"),
                "Osada et al. 2001 (D2), of geodesic distances and of distances in the signature",
            ),
            Measure(
                "surface_moments",
                ("rotation", "reflection", "scale"),
                "the same moments of the surface as it stands: what the paper's Fig. 8 compares with",
            ),
        )
    }
)

DEFAULT_MEASURE: Final = "spectrum"


def get_measure(name: str) -> Measure:
    """Return the measure called `name`; ParameterError lists the known ones."""
    if name not in MEASURES:
        raise ParameterError(f"measure must be one of {', '.join(MEASURES)}, not {name!r}")
    return MEASURES[name]


def compare(a: Signature, b: Signature, measure: str = DEFAULT_MEASURE) -> float:
    """Distance between two signatures under `measure`: 0 for the same one.

    Raises
    ------
    ParameterError
        If there is no such measure, or the signatures were made with different parameters.
    """
    chosen = get_measure(measure)
    if (a.parameters, a.version) != (b.parameters, b.version):
        raise ParameterError("signatures made with different parameters or versions cannot be compared")
    return float(chosen.distances(a.descriptors[measure], b.descriptors[measure][None, :])[0])
