"""The canonical form of a surface: canonical coordinates for every vertex, not only for samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Ints, frozen
from unbend.brief import brief, counted, counted_points
from unbend.embedding.extension import extend
from unbend.errors import ParameterError
from unbend.geodesics.distances import Update, distance_rows
from unbend.geodesics.interpolation import interpolate
from unbend.geodesics.stencils import stencils_of
from unbend.geodesics.voronoi import geodesic_voronoi
from unbend.mesh.surface import Surface
from unbend.notebook.pictured import Pictured
from unbend.signature.parameters import Parameters
from unbend.signature.pipeline import compute_signature
from unbend.signature.signature import Signature

LANDMARKS: Final = 100
"""Number of samples from which distances to every vertex are computed. More do not lower the stress of the form."""

_ROWS_BYTES: Final = 2**28
"""Memory for these distances. Surfaces of more than 670,000 vertices get fewer landmarks."""

_FEWEST: Final = 2  # least landmarks: this number times (dimensions + 1)

_BATCH: Final = 16  # rows computed at a time, in double precision

_REACH: Final = 2.0  # radius of interpolation in radii of the sampling, so that every vertex has several samples in it


@dataclass(frozen=True, eq=False)
class CanonicalForm(Pictured):
    """A surface with canonical coordinates for every vertex."""

    points: Floats
    """Canonical coordinates of all vertices, (n, m), in the signature's pose and unit. At `signature.samples` they are
    equal to `signature.points`. NaN at vertices that no face uses."""
    faces: Ints
    """Faces of the surface, (f, 3) int32."""
    signature: Signature

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points, np.float64))
        object.__setattr__(self, "faces", frozen(self.faces, np.int32))

    def __repr__(self) -> str:
        return brief(
            self,
            counted_points(self.points.shape),
            counted(len(self.faces), "face"),
            f"stress {self.signature.stress:.3g}",
        )

    @cached_property
    def surface(self) -> Surface:
        """The form as a surface in its first three dimensions. Missing dimensions are zero."""
        return Surface(in_space(self.points), self.faces)


def in_space(points: Floats) -> Floats:
    """Return the first three coordinates of points (n, m). Missing coordinates are zero."""
    space = np.zeros((len(points), 3))
    shown = min(3, points.shape[1])
    space[:, :shown] = points[:, :shown]
    return space


def canonical_form(
    surface: Surface,
    parameters: Parameters | None = None,
    *,
    signature: Signature | None = None,
    threads: int | None = None,
) -> CanonicalForm:
    """Compute the bending-invariant form of every vertex of `surface`, not only of the signature's samples.

    Each vertex is placed by its geodesic distances to up to 100 of the samples, by the same criterion as the samples
    (see `unbend.embedding.extension`). The remaining differences of the samples from the signature are interpolated
    along the surface and subtracted.

    Parameters
    ----------
    surface : Surface
        Its faces must be connected, as `read_mesh` ensures.
    parameters : Parameters, optional
        Parameters of the signature to compute; `Parameters()` by default.
    signature : Signature, optional
        Signature of this surface, if it is known already. Its computation takes most of the time.
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    CanonicalForm
        The same for the same input on every run.

    Raises
    ------
    MeshGeometryError
        If the surface has no area, or its faces are not connected.
    ParameterError
        If both parameters and a signature are given, the signature is not of this surface, or `threads` is below 1.
    """
    known = _signature(surface, parameters, signature, threads)
    samples, update = known.samples.astype(np.int32), known.parameters.update
    squared = _squared_rows(surface, samples[: _landmark_count(surface, known)], known.scale, update, threads)
    # On a line the stress has a minimum in every gap between landmarks, so neighbours would move to different minima.
    refine = known.parameters.method == "least_squares" and known.points.shape[1] > 1
    points = extend(known.points, known.samples, squared, refine=refine, threads=threads)
    points += _correction(surface, samples, known.points - points[samples], update)
    points[samples] = known.points
    return CanonicalForm(points, surface.faces, known)


def _signature(
    surface: Surface, parameters: Parameters | None, signature: Signature | None, threads: int | None
) -> Signature:
    if signature is None:
        return compute_signature(surface, parameters, threads=threads)
    if parameters is not None:
        raise ParameterError("give parameters or a signature, not both: a signature has its own parameters")
    if not np.isin(signature.samples, surface.used_vertices).all():
        raise ParameterError("the signature is of another surface: it has samples that are not vertices of this one")
    return signature


def _landmark_count(surface: Surface, signature: Signature) -> int:
    affordable = _ROWS_BYTES // (4 * len(surface.vertices))
    least = _FEWEST * (signature.points.shape[1] + 1)
    return int(min(len(signature.samples), max(min(LANDMARKS, affordable), least)))


def _squared_rows(
    surface: Surface, sources: Ints, unit: float, update: Update, threads: int | None
) -> NDArray[np.float32]:
    stencils = stencils_of(surface)
    squared = np.empty((len(sources), len(surface.vertices)), np.float32)
    for start in range(0, len(sources), _BATCH):
        part = slice(start, start + _BATCH)
        rows = distance_rows(stencils, sources[part], None, update, threads)
        rows /= unit
        np.multiply(rows, rows, out=squared[part], casting="same_kind")
    return squared


def _correction(surface: Surface, samples: Ints, missing: Floats, update: Update) -> Floats:
    distances = geodesic_voronoi(surface, samples, update=update).distances
    radius = float(distances[np.isfinite(distances)].max())
    if radius == 0:  # every vertex is a sample
        return np.zeros((len(surface.vertices), missing.shape[1]))
    return interpolate(stencils_of(surface), samples, missing, _REACH * radius, update)
