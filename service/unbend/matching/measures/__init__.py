"""Measures, which are distances between signatures: `vectors` and `pairs` define them, `registry` lists them."""

from unbend.matching.measures.protocol import Measure, PairMeasure, VectorMeasure
from unbend.matching.measures.registry import (
    DEFAULT_MEASURE,
    MEASURES,
    VECTOR_MEASURES,
    compare,
    get_measure,
    get_vector_measure,
)

__all__ = [
    "DEFAULT_MEASURE",
    "MEASURES",
    "VECTOR_MEASURES",
    "Measure",
    "PairMeasure",
    "VectorMeasure",
    "compare",
    "get_measure",
    "get_vector_measure",
]
