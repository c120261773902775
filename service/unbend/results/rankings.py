"""Rankings of classes and shapes by their distance from a query."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

from unbend.brief import brief, counted, noted
from unbend.errors import NotFoundError
from unbend.matching.classification import ClassMatch
from unbend.matching.partial.comparison import Comparison, Relation
from unbend.names import is_shape_id
from unbend.results.decoding import known_fields

DEFAULT_K: Final = 10
"""Number of shapes in a ranking by default."""

_SHOWN: Final = 200
"""Most characters of a query that an error shows."""


@dataclass(frozen=True)
class PartRelation:
    """How a query relates to a shape, under a measure of parts."""

    relation: Relation
    """The query is a part of the shape, contains it, or is a whole like it."""
    covered: float
    """Area of the smaller surface over that of the larger one."""
    matched: float
    """Share of the compared circles that are where the others say they must be."""
    residual: float
    """Root mean square error of distances between matched circles, in units of the query."""
    scale: float
    """Length in units of the shape of a length 1 in units of the query."""
    centre: Sequence[float]
    """A point of the query, (3,), as far as possible from the boundary of the smaller surface."""
    place: Sequence[float]
    """The same place on the shape, (3,), in the coordinates of its file."""

    def __repr__(self) -> str:
        return brief(
            self, self.relation, f"covered {self.covered:.3g}", f"matched {self.matched:.3g}",
            f"residual {self.residual:.3g}", f"scale {self.scale:.3g}",
        )  # fmt: skip

    @classmethod
    def of(cls, compared: Comparison) -> Self:
        """Return the relation that a comparison found."""
        return cls(**known_fields(cls, vars(compared)))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the relation of JSON values."""
        return cls(**known_fields(cls, values) | {"centre": tuple(values["centre"]), "place": tuple(values["place"])})

    def as_dict(self) -> dict[str, Any]:
        """Return the relation as JSON values."""
        return dict(vars(self)) | {"centre": list(self.centre), "place": list(self.place)}


@dataclass(frozen=True)
class ShapeMatch:
    """A stored shape and its distance from a query."""

    id: str
    name: str
    label: str | None
    distance: float
    part: PartRelation | None = None
    """How the query relates to the shape, under a measure of parts."""

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the match of JSON values."""
        part = values.get("part")
        return cls(**known_fields(cls, values) | {"part": PartRelation.from_dict(part) if part else None})

    def as_dict(self) -> dict[str, Any]:
        """Return the match as JSON values."""
        return dict(vars(self)) | {"part": self.part.as_dict() if self.part else None}


@dataclass(frozen=True)
class Ranking:
    """The classes and shapes nearest to a query, best first."""

    measure: str
    classes: Sequence[ClassMatch]
    shapes: Sequence[ShapeMatch]
    known: bool | None
    """Whether the query is near enough to the best class to belong to it; None if the class has a single member."""
    warnings: Sequence[str] = ()
    """Reasons why the ranking may be wrong, and what to do."""
    exact: bool = True
    """Whether every shape was compared. If not, an approximate index may have missed a near shape."""

    def __repr__(self) -> str:
        known = {True: "known", False: "unknown", None: ""}
        return brief(
            self, self.measure, *(f"best class {match.label!r}" for match in self.classes[:1]), known[self.known],
            counted(len(self.shapes), "shape"), counted(len(self.classes), "class", "classes"),
            noted(len(self.warnings), "warning"),
        )  # fmt: skip

    def _repr_html_(self) -> str:
        from unbend.notebook.html import ranking_html  # noqa: PLC0415  programs without a notebook need no templates

        return ranking_html(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the ranking of JSON values."""
        return cls(
            values["measure"],
            [ClassMatch(**known_fields(ClassMatch, match)) for match in values["classes"]],
            [ShapeMatch.from_dict(match) for match in values["shapes"]],
            values["known"],
            tuple(values.get("warnings", ())),
            values.get("exact", True),  # rankings of earlier versions were
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the ranking as plain JSON values, in the form of the HTTP contract."""
        return {  # `asdict` takes longer for a thousand classes than the search
            "measure": self.measure,
            "classes": [dict(vars(match)) for match in self.classes],
            "shapes": [match.as_dict() for match in self.shapes],
            "known": self.known,
            "warnings": list(self.warnings),
            "exact": self.exact,
        }


def shape_id_of(query: object) -> str | None:
    """Return the query if it is the id of a stored shape; None if it is a mesh.

    Raises
    ------
    NotFoundError
        If it is text, and neither an id nor the path of a file.
    """
    if not isinstance(query, str):
        return None
    if is_shape_id(query):
        return query
    try:
        exists = Path(query).exists()
    except OSError:  # longer than any path, such as the text of a mesh
        exists = False
    if not exists:
        raise NotFoundError(f"{query[:_SHOWN]!r} is neither the id of a stored shape nor a file").with_advice(
            "Check the path or the id."
        )
    return None
