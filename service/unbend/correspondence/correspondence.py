"""The type of a correspondence: for each vertex of one surface a point of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unbend.arrays import Bools, Floats, Indices, Ints, frozen
from unbend.brief import brief, counted


@dataclass(frozen=True)
class Candidate:
    """A map that was considered, as it was when all candidates were compared at the samples."""

    cost: float
    """The product of the figures that follow, and of how far the functions of both surfaces disagree. The lower, the
    better; costs compare candidates of the same pair only."""
    stretch: float
    """Mean change of geodesic distances, over the square root of the area."""
    curvature: float
    """Mean squared difference of the curvatures, in variances: 0 if equal, 2 if unrelated."""
    agreement: float
    """Mean cosine between oriented tangent planes: 1 if the orientation agrees everywhere, -1 if nowhere."""
    distance: float
    """Mean distance of its images from those of the chosen map, over the square root of the area of `b`."""


@dataclass(frozen=True, eq=False)
class Correspondence:
    """For each vertex of a surface `a`, the point of a surface `b` that is the same place."""

    faces: Ints
    """The face of `b` for each of the n vertices of `a`, (n,) int32; -1 at vertices that no face of `a` uses."""
    barycentric: Floats
    """The place in that face: weights of its corners, (n, 3); NaN where there is no face."""
    target_faces: Ints
    """The faces of `b`, (m, 3) int32, to which `faces` refers."""
    target_vertices: int
    """Number of vertices of `b`."""
    confidence: Floats
    """How well distances to near points are kept, (n,): 1 if exactly, falling to 0; 0 where there is no face."""
    residual: float
    """Area-weighted mean change of the distances to near points, over the square root of the area."""
    oriented: bool
    """Whether the orientation of the triangles decided between mirrored maps. Otherwise the surfaces have no known
    sides, or the map agrees with neither orientation, and the map may be a mirror image of the right one."""
    ambiguous: bool
    """Whether a different map keeps distances and curvature nearly as well, as for a rotation of a round body."""
    candidates: tuple[Candidate, ...]
    """All distinct maps that were considered, the chosen one first, then by cost."""

    def __post_init__(self) -> None:
        kinds = {
            "faces": np.int32, "barycentric": np.float64, "target_faces": np.int32, "confidence": np.float64,
        }  # fmt: skip
        for name, kind in kinds.items():
            object.__setattr__(self, name, frozen(getattr(self, name), kind))

    def __repr__(self) -> str:
        return brief(
            self, f"{int(self.matched.sum())} of {counted(len(self.faces), 'vertex', 'vertices')} matched",
            f"residual {self.residual:.3g}", "oriented" if self.oriented else "not oriented",
            "ambiguous" if self.ambiguous else "", counted(len(self.candidates), "candidate"),
        )  # fmt: skip

    @property
    def matched(self) -> Bools:
        """Whether each vertex of `a` has a point, (n,)."""
        return np.asarray(self.faces >= 0)

    @property
    def vertices(self) -> Indices:
        """The corner of the face that is nearest to each point, (n,); -1 where there is none."""
        nearest = self.target_faces[self.faces, np.nan_to_num(self.barycentric).argmax(axis=1)]
        return np.where(self.matched, nearest, -1).astype(np.int64)
