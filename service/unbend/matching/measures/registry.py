"""The measures by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from unbend.errors import ParameterError, check_choice
from unbend.matching.measures.pairs import HAUSDORFF, MAX_HAUSDORFF, REEB, RIGID
from unbend.matching.measures.protocol import Measure, PairMeasure, VectorMeasure
from unbend.matching.measures.vectors import COMBINED, DIMENSION, DISTRIBUTION, MOMENTS, SPECTRUM, SURFACE_MOMENTS
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
    """Return the measure called `name`, or raise ParameterError, which lists the names."""
    check_choice("measure", name, MEASURES)
    return MEASURES[name]


def get_vector_measure(name: str) -> VectorMeasure:
    """Return the vector measure called `name`, or raise ParameterError, which lists the names."""
    check_choice("measure", name, VECTOR_MEASURES)
    return VECTOR_MEASURES[name]


def compare(a: Signature, b: Signature, measure: str = DEFAULT_MEASURE) -> float:
    """Return the distance between two signatures under `measure`. Equal signatures have distance 0.

    Raises
    ------
    ParameterError
        If there is no such measure, or the signatures were made with different parameters or versions.
    """
    chosen = get_measure(measure)
    check_comparable(a, b)
    return chosen.distance(a, b)


def check_comparable(a: Signature, b: Signature) -> None:
    """Raise ParameterError if two signatures were made with different parameters or versions."""
    if (a.parameters, a.version) != (b.parameters, b.version):
        raise ParameterError("signatures made with different parameters or versions cannot be compared")
