"""Maps of a library: its shapes as points, with similar shapes near each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, Self

from unbend.brief import brief, counted, noted
from unbend.results.decoding import known_fields

MapDistance = Literal["l1", "squared_l2"]
"""The sum of absolute differences, which searches use, or of squared ones, as in the paper's D_M (section 2.3)."""


@dataclass(frozen=True)
class MapItem:
    """A shape and its point on the map."""

    id: str
    name: str
    label: str | None
    point: Sequence[float]
    """Coordinates on the map, computed with the chosen measure."""
    original: Sequence[float]
    """Coordinates on a second map, computed from the surface in space. Fig. 8 of the paper shows both side by side."""


@dataclass(frozen=True)
class ShapeMap:
    """Shapes as points whose distances approximate those of their descriptors (the paper's Fig. 8)."""

    measure: str
    stress: float
    """Stress of the map computed with the chosen measure (eq. 2 of the paper)."""
    original_stress: float
    """Stress of the map computed from the surfaces in space."""
    count: int
    """Number of shapes that the map's shapes were chosen from."""
    items: list[MapItem]
    warnings: Sequence[str] = ()
    """Why the map is empty, although the library has shapes."""

    def __repr__(self) -> str:
        return brief(
            self, self.measure, f"{len(self.items)} of {counted(self.count, 'shape')}", f"stress {self.stress:.3g}",
            noted(len(self.warnings), "warning"),
        )  # fmt: skip

    def _repr_html_(self) -> str:
        from unbend.notebook.html import map_html  # noqa: PLC0415  programs without a notebook need no templates

        return map_html(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the map of JSON values."""
        items = [MapItem(**known_fields(MapItem, item)) for item in values["items"]]
        return cls(**known_fields(cls, values) | {"items": items, "warnings": tuple(values.get("warnings", ()))})

    def as_dict(self) -> dict[str, Any]:
        """Return the map as plain JSON values, in the form of the HTTP contract."""
        return asdict(self) | {"warnings": list(self.warnings)}
