"""Matches of stored shapes: which point of one is which point of the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from unbend.arrays import Bools, Floats, Indices, Ints, frozen
from unbend.brief import brief, counted
from unbend.correspondence.correspondence import Correspondence
from unbend.correspondence.export import correspondence_arrays
from unbend.mesh.surface import Surface


@dataclass(frozen=True, eq=False)
class PointMap:
    """For each vertex of the file of a shape `a`, the point of the file of a shape `b` that is the same place."""

    corners: Ints
    """Three vertices of the file of `b`, around the point, for each of the n vertices of the file of `a`, (n, 3) int32;
    -1 at vertices without a point."""
    barycentric: Floats
    """Weights of the corners, (n, 3); 0 at vertices without a point."""
    confidence: Floats
    """How well distances to near points are kept, (n,): 1 if exactly, falling to 0."""
    residual: float
    """Area-weighted mean change of the distances to near points, over the square root of the area."""
    oriented: bool
    """Whether the orientation of the triangles decided between mirrored maps."""
    ambiguous: bool
    """Whether a different map keeps distances and curvature nearly as well, as for a rotation of a round body."""

    def __post_init__(self) -> None:
        for name, kind in {"corners": np.int32, "barycentric": np.float64, "confidence": np.float64}.items():
            object.__setattr__(self, name, frozen(getattr(self, name), kind))

    def __repr__(self) -> str:
        return brief(
            self, f"{int(self.matched.sum())} of {counted(len(self.corners), 'vertex', 'vertices')} matched",
            f"residual {self.residual:.3g}", "oriented" if self.oriented else "not oriented",
            "ambiguous" if self.ambiguous else "",
        )  # fmt: skip

    @property
    def matched(self) -> Bools:
        """Whether each vertex of `a` has a point, (n,)."""
        return np.asarray(self.corners[:, 0] >= 0)

    @property
    def vertices(self) -> Indices:
        """The corner that is nearest to each point, (n,); -1 where there is none."""
        nearest = np.take_along_axis(self.corners, self.barycentric.argmax(axis=1)[:, None], axis=1)
        return nearest[:, 0].astype(np.int64)

    @classmethod
    def of(cls, found: Correspondence, a: Surface, b: Surface) -> Self:
        """Return `found`, from `match(a, b)`, in terms of the files of both surfaces."""
        return cls.from_dict(correspondence_arrays(found, a, b))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the map of the members of a file of `export_correspondence`."""
        members: dict[str, Any] = {field.name: np.asarray(values[field.name]) for field in fields(cls)}
        return cls(
            **members
            | {
                "residual": float(values["residual"]),
                "oriented": bool(values["oriented"]),
                "ambiguous": bool(values["ambiguous"]),
            }
        )
