"""Stored shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal, Self

from unbend.brief import assigned, brief, counted, noted
from unbend.mesh.policy import MeshPolicy
from unbend.results.decoding import known_fields
from unbend.signature.parameters import Parameters

IfKnown = Literal["keep", "update"]
"""Whether a shape that is stored already keeps its name, label and metadata, or takes the new ones."""

ShapeOrder = Literal["oldest", "newest"]
"""The shape that a list begins with."""


@dataclass(frozen=True, eq=False)
class ShapeRecord:
    """A member of the library, without its arrays. Two records are equal if their `state` is equal."""

    id: str
    name: str
    label: str | None
    metadata: dict[str, Any]
    sha256: str
    size: int
    parameters: Parameters
    policy: MeshPolicy
    version: str
    area: float
    stress: float
    dimension: int | None
    """Effective dimension; None for signatures of version 4 or earlier."""
    report: dict[str, Any]
    warnings: list[str]
    """Reasons why the signature may be wrong, and what to do."""
    created_at: datetime
    updated_at: datetime
    revision: int
    """The revision of the library that last changed the shape; 0 if it was never changed."""
    seq: int
    """The shape's place in the order of adding."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ShapeRecord) and self.state == other.state

    def __hash__(self) -> int:
        return hash((self.id, self.revision))

    @property
    def state(self) -> dict[str, Any]:
        """The fields of a record."""
        return {name: getattr(self, name) for name in ShapeRecord.__dataclass_fields__}

    def __repr__(self) -> str:
        return brief(self, *self._facts())

    def _facts(self) -> tuple[str, ...]:
        return (
            repr(self.name), *assigned({"label": self.label, "id": self.id}), f"version {self.version}",
            noted(len(self.warnings), "warning"),
        )  # fmt: skip

    @property
    def file_type(self) -> str:
        """The format of the uploaded file."""
        return str(self.report["file_type"])

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the record of a response of the service."""
        return cls(
            **known_fields(cls, values)
            | {
                "parameters": Parameters.from_dict(values["parameters"]),
                "policy": MeshPolicy.from_dict(values["policy"]),
                "created_at": datetime.fromisoformat(values["created_at"]),
                "updated_at": datetime.fromisoformat(values["updated_at"]),
            }
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values, in the form of the HTTP contract."""
        return {
            **self.state,
            "parameters": self.parameters.as_dict(),
            "policy": self.policy.as_dict(),
            "created_at": self.created_at.isoformat(),
            "updated_at": self.updated_at.isoformat(),
        }


@dataclass(frozen=True, eq=False)
class AddedShape(ShapeRecord):
    """A shape as `add` returns it. It equals the record that `get` returns."""

    is_new: bool = True
    """Whether this call stored the shape. If not, the library had its file already."""
    ignored: Sequence[str] = ()
    """Fields of "name", "label" and "metadata" that a stored shape did not take: add it with `if_known="update"`."""
    updated: Sequence[str] = ()
    """Fields that a stored shape took."""

    def __repr__(self) -> str:
        kept = f"ignored {', '.join(self.ignored)}" if self.ignored else ""
        return brief(self, *self._facts(), "" if self.is_new else "stored before", kept)

    @classmethod
    def of(cls, shape: ShapeRecord, *, is_new: bool, ignored: Sequence[str] = (), updated: Sequence[str] = ()) -> Self:
        """Return a stored shape with the outcome of adding it."""
        return cls(**shape.state, is_new=is_new, ignored=tuple(ignored), updated=tuple(updated))


@dataclass(frozen=True)
class ShapePage:
    """A page of shapes in the order of adding, and the cursor of the next page."""

    items: list[ShapeRecord]
    next_cursor: str | None

    def __repr__(self) -> str:
        return brief(self, counted(len(self.items), "shape"), "more follow" if self.next_cursor else "")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the page of a response of the service."""
        return cls([ShapeRecord.from_dict(item) for item in values["items"]], values["next_cursor"])
