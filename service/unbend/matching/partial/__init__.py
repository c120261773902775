"""Comparison of pieces with wholes by their local signatures."""

from unbend.matching.partial.comparison import Comparison, compare_parts
from unbend.matching.partial.measure import PART_MEASURES, PartMeasure
from unbend.matching.partial.profiles import Profiles, profiles_of
from unbend.matching.partial.search import Load, PartSearch, search_parts

__all__ = [
    "PART_MEASURES",
    "Comparison",
    "Load",
    "PartMeasure",
    "PartSearch",
    "Profiles",
    "compare_parts",
    "profiles_of",
    "search_parts",
]
