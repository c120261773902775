"""The measures by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from unbend.errors import ParameterError
from unbend.matching.measures.combined import COMBINED
from unbend.matching.measures.dimension import DIMENSION
from unbend.matching.measures.distribution import DISTRIBUTION
from unbend.matching.measures.hausdorff import HAUSDORFF, MAX_HAUSDORFF
from unbend.matching.measures.moments import MOMENTS, SURFACE_MOMENTS
from unbend.matching.measures.protocol import Measure, PairMeasure, VectorMeasure
from unbend.matching.measures.reeb import REEB
from unbend.matching.measures.rigid import RIGID
from unbend.matching.measures.spectrum import SPECTRUM
from unbend.signature.signature import Signature

VECTOR_MEASURES: Final[Mapping[str, VectorMeasure]] = MappingProxyType(
    {measure.name: measure for measure in (SPECTRUM, COMBINED, MOMENTS, DISTRIBUTION, DIMENSION, SURFACE_MOMENTS)}
)

PAIR_MEASURES: Final[Mapping[str, PairMeasure]] = MappingProxyType(
    {measure.name: measure for measure in (RIGID, HAUSDORFF, MAX_HAUSDORFF, REEB)}
)

MEASURES: Final[Mapping[str, Measure]] = MappingProxyType({**VECTOR_MEASURES, **PAIR_MEASURES})

DEFAULT_MEASURE: Final = SPECTRUM.name


def get_measure(name: str) -> Measure:
    """Return the measure called `name`; ParameterError lists the known ones."""
    if name not in MEASURES:
        raise ParameterError(f"measure must be one of {', '.join(MEASURES)}, not {name!r}")
    return MEASURES[name]


def get_vector_measure(name: str) -> VectorMeasure:
    """Return the measure called `name` if it compares vectors; ParameterError lists those that do."""
    if name not in VECTOR_MEASURES:
        raise ParameterError(f"measure must be one of {', '.join(VECTOR_MEASURES)}, not {name!r}")
    return VECTOR_MEASURES[name]


def compare(a: Signature, b: Signature, measure: str = DEFAULT_MEASURE) -> float:
    """Distance between two signatures under `measure`: 0 for the same one.

    Raises
    ------
    ParameterError
        If there is no such measure, or the signatures were made with different parameters.
    """
    chosen = get_measure(measure)
    check_comparable(a, b)
    return chosen.distance(a, b)


def check_comparable(a: Signature, b: Signature) -> None:
    """Raise ParameterError if two signatures were made with different parameters or versions."""
    if (a.parameters, a.version) != (b.parameters, b.version):
        raise ParameterError("signatures made with different parameters or versions cannot be compared")
