"""Local signatures of a surface: what it looks like from each of a few hundred points (section 5, "semilocal")."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from unbend.arrays import Floats, Singles, frozen
from unbend.brief import brief, counted
from unbend.errors import MeshGeometryError
from unbend.geodesics.distances import distance_rows
from unbend.geodesics.sampling import sample_farthest
from unbend.geodesics.stencils import stencils_of
from unbend.geodesics.voronoi import boundary_distances
from unbend.local.growth import add_growth
from unbend.local.refined import refined
from unbend.mesh.surface import Surface
from unbend.threads import share_out

LOCAL_VERSION: Final = "1"
"""Version of local signatures. It changes when the same surface gives different numbers than before."""

CENTRES: Final = 300
"""Points around which circles are drawn. A piece and a whole choose different points, so both need many."""

OCTAVE: Final = 4
"""Rungs of the ladder of radii to one doubling."""

RUNGS: Final = 19
"""Circles around each centre. From 0.05 to 1.2 times the square root of the area, they reach across a piece, too."""

SMALLEST: Final = 2.0**-4.25
"""Radius of the smallest circle over the square root of the area; rounded to the nearest rung."""

STEPS: Final = 255
"""Distances between centres are stored in steps of 1/255 of the largest: usually less than the centres' spacing."""

_AT_A_TIME: Final = 1 << 24
"""Most distances in memory at a time for each thread."""


@dataclass(frozen=True, eq=False)
class LocalSignatures:
    """The geodesic circles around c points of a surface.

    A circle that does not touch the boundary is the same in a piece as in the whole: no cut comes near it. Its radii
    are absolute, powers of 2^(1/4) in the unit of the vertices, because a piece does not know the size of the whole;
    on a surface of another scale, the same rings are some rungs higher.
    """

    places: Singles
    """Coordinates of the centres, (c, 3), in the order of farthest point sampling."""
    growth: Singles
    """Area of each circle over the square of its radius, (c, 19): pi in a plane."""
    first: int
    """The radius of the smallest circles is 2^(first / 4)."""
    reach: Singles
    """Distance of each centre from the boundary, (c,); infinite without a boundary."""
    distances: Singles
    """Geodesic distances between the centres, (c, c), in 255 equal steps."""
    area: float
    """Area of the surface, in squared units of the vertices."""
    version: str = LOCAL_VERSION

    def __post_init__(self) -> None:
        for name in ("places", "growth", "reach", "distances"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float32))

    def __repr__(self) -> str:
        radii = self.radii
        return brief(
            self, counted(len(self.places), "centre"), f"radii {radii[0]:.3g} to {radii[-1]:.3g}",
            "open" if self.is_open else "closed", f"version {self.version}",
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.places)

    @property
    def radii(self) -> Floats:
        """Radius of each circle, (19,), in the unit of the vertices."""
        return np.asarray(2.0 ** ((self.first + np.arange(self.growth.shape[1])) / OCTAVE))

    @property
    def rings(self) -> Singles:
        """Area between neighbouring circles over the square of the larger radius, (c, 18): 0.92 in a plane."""
        inner = np.float32(2.0 ** (-2 / OCTAVE))
        return np.asarray(self.growth[:, 1:] - inner * self.growth[:, :-1])

    @property
    def is_open(self) -> bool:
        """Whether the surface has a boundary."""
        return bool(np.isfinite(self.reach).any())


def local_signatures(
    surface: Surface,
    *,
    centres: int = CENTRES,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> LocalSignatures:
    """Compute the local signatures of `surface`.

    Parameters
    ----------
    surface : Surface
        Its faces must be connected. A coarse surface is refined first, to at least 3500 vertices.
    centres : int, default 300
        Number of circles' centres, farthest point samples; fewer if the surface has fewer vertices.
    threads : int, optional
        All cores by default. The result does not depend on it.
    progress : callable, optional
        Receives the share of circles done.

    Raises
    ------
    MeshGeometryError
        If the surface has no area, or its faces are not connected.
    ParameterError
        If `centres` or `threads` is below 1.

    Examples
    --------
    >>> from unbend.mesh.shapes import sphere
    >>> local = local_signatures(sphere(4))
    >>> len(local), local.is_open, local.growth.shape
    (300, False, (300, 19))
    """
    if not surface.area > 0:
        raise MeshGeometryError("every face has zero area")
    fine = refined(surface)
    stencils = stencils_of(fine)
    samples = sample_farthest(fine, stencils, min(centres, len(fine.used_vertices))).samples.astype(np.int32)
    first = round(OCTAVE * np.log2(SMALLEST * np.sqrt(surface.area)))
    radii = 2.0 ** ((first + np.arange(RUNGS)) / OCTAVE)
    growth, between = np.zeros((len(samples), RUNGS)), np.empty((len(samples), len(samples)))

    def draw(part: slice) -> None:
        step = max(1, _AT_A_TIME // len(fine.vertices))
        for start in range(part.start, part.stop, step):
            some = slice(start, min(part.stop, start + step))
            rows = distance_rows(stencils, samples[some], None, "spherical", 1)
            between[some] = rows[:, samples]
            add_growth(rows, fine.faces, fine.face_areas, radii, growth[some])

    share_out(len(samples), threads, draw, progress)
    if not np.isfinite(between).all():
        raise MeshGeometryError("the faces are not connected: keep one component")
    return LocalSignatures(
        places=fine.vertices[samples].astype(np.float32),
        growth=(growth / radii**2).astype(np.float32),
        first=first,
        reach=boundary_distances(fine)[samples].astype(np.float32),
        distances=_in_steps(np.minimum(between, between.T)).astype(np.float32),
        area=surface.area,
    )


def enlarged(local: LocalSignatures, rungs: float) -> LocalSignatures:
    """Return the local signatures of the same surface enlarged by a part of a rung, with one circle fewer.

    Circles between those that were drawn are interpolated.
    """
    factor = np.float32(2.0 ** (rungs / OCTAVE))
    count = local.growth.shape[1]
    smooth = CubicSpline(np.arange(count), np.log(local.growth), axis=1)
    return replace(
        local,
        places=local.places * factor,
        growth=np.exp(smooth(np.arange(1, count) - rungs)).astype(np.float32),
        first=local.first + 1,
        reach=local.reach * factor,
        distances=local.distances * factor,
        area=local.area * float(factor) ** 2,
    )


def _in_steps(distances: Floats) -> Floats:
    """Return distances rounded to 255 equal steps up to the largest, as they are stored."""
    step = distances.max(initial=0.0) / STEPS
    return np.asarray(np.rint(distances / step) * step if step > 0 else distances)
