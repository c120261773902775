"""The measures that compare pieces with wholes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final


@dataclass(frozen=True)
class PartMeasure:
    """A comparison of local signatures."""

    name: str
    any_scale: bool
    """Whether query and shapes may have different units."""


PARTIAL: Final = PartMeasure("partial", any_scale=False)
"""Pieces and wholes whose vertices have the same unit, such as millimetres."""

PARTIAL_ANY_SCALE: Final = PartMeasure("partial_any_scale", any_scale=True)
"""Pieces and wholes in different units: the scale at which they agree best counts."""

PART_MEASURES: Final[Mapping[str, PartMeasure]] = MappingProxyType(
    {measure.name: measure for measure in (PARTIAL, PARTIAL_ANY_SCALE)}
)
