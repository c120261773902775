"""Distance fields and the distance matrix, with checked arguments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from unbend.arrays import Floats, Ints
from unbend.errors import ParameterError, check_choice
from unbend.geodesics.fronts import march_each, raise_to_straight
from unbend.geodesics.stencils import Stencils, stencils_of
from unbend.mesh.surface import Surface
from unbend.threads import Progress, check_threads, share_out

Update = Literal["spherical", "planar"]


@dataclass(frozen=True, eq=False)
class GeodesicMatrix:
    """Distances between samples, and the asymmetry of the marched distances."""

    distances: Floats  # (k, k), symmetric, zero diagonal
    asymmetry: float
    """Largest |d_ij - d_ji| over the largest distance; 0 for a single sample."""


def geodesic_distances(
    surface: Surface, sources: ArrayLike, *, update: Update = "spherical", threads: int | None = None
) -> Floats:
    """Geodesic distances from each source to every vertex, by fast marching on triangulated domains.

    Parameters
    ----------
    surface : Surface
        Any triangulated surface; it need not be closed, manifold or oriented.
    sources : int or (k,) array of int
        Vertex indices.
    update : {"spherical", "planar"}, default "spherical"
        Shape of the front in a triangle: a circle around a virtual point source (Novotni & Klein 2002) or a straight
        line (Kimmel & Sethian 1998, as in the paper). Circles take the same time and have smaller errors.
    threads : int, optional
        Threads to use, all cores by default. The result does not depend on it.

    Returns
    -------
    (k, n) float64
        In the units of the vertices; inf where no path leads to the vertex.

    Raises
    ------
    ParameterError
        If a source is not a vertex, or `update` or `threads` is not one of the values above.

    Examples
    --------
    >>> from unbend.mesh.shapes import sphere
    >>> surface = sphere()
    >>> distances = geodesic_distances(surface, 0)
    >>> distances.shape
    (1, 642)
    >>> round(float(distances.max()), 1)  # half a great circle
    3.1
    """
    return distance_rows(stencils_of(surface), check_vertices(surface, sources, "sources"), None, update, threads)


def geodesic_matrix(
    surface: Surface, samples: ArrayLike, *, update: Update = "spherical", threads: int | None = None
) -> Floats:
    """Symmetric matrix of geodesic distances between `samples`, as `geodesic_distances` computes them.

    It needs memory for the stencils, the matrix and one full row per thread, but not for the full rows of all samples.

    Returns
    -------
    (k, k) float64
        The smaller of the distances in both directions; inf between components. Fast marching is not exactly symmetric,
        and its distances are mostly too long, so the smaller distance is nearer to the exact one than the mean of both.

    Examples
    --------
    >>> from unbend.mesh.shapes import sphere
    >>> geodesic_matrix(sphere(), [0, 1, 2]).shape
    (3, 3)
    """
    return sampled_matrix(stencils_of(surface), check_vertices(surface, samples, "samples"), update, threads).distances


def sampled_matrix(
    stencils: Stencils,
    samples: Ints,
    update: Update = "spherical",
    threads: int | None = None,
    progress: Progress | None = None,
) -> GeodesicMatrix:
    """Return the same matrix as `geodesic_matrix`, from existing stencils, and its asymmetry."""
    rows = distance_rows(stencils, samples, samples, update, threads, progress)
    with np.errstate(invalid="ignore"):  # inf - inf between components
        difference = np.abs(rows - rows.T)
    finite = np.isfinite(difference)
    largest = rows[np.isfinite(rows)].max(initial=0.0)
    asymmetry = difference[finite].max(initial=0.0) / largest if largest > 0 else 0.0
    return GeodesicMatrix(np.minimum(rows, rows.T), float(asymmetry))


def distance_rows(
    stencils: Stencils,
    sources: Ints,
    columns: Ints | None,
    update: Update,
    threads: int | None,
    progress: Progress | None = None,
) -> Floats:
    """Return distances from `sources` to `columns` (None for every vertex), (k, len(columns)).

    Each free thread takes the next block of sources. Rows are computed independently, so the result does not depend on
    the number of threads. `progress` receives the share of rows done.
    """
    check_update(update)
    check_threads(threads)
    wanted = np.arange(len(stencils.place), dtype=np.int32) if columns is None else columns
    rows = np.empty((len(sources), len(wanted)))

    def march_part(part: slice) -> None:
        starts, ends = stencils.place[sources[part]], stencils.place[wanted]
        march_each(stencils, starts, ends, rows[part], spherical=update == "spherical")
        raise_to_straight(stencils.points, sources[part], wanted, rows[part])

    share_out(len(sources), threads, march_part, progress)
    return rows


def check_update(update: str) -> None:
    """Raise ParameterError unless `update` is one of `Update`."""
    check_choice("update", update, get_args(Update))


def check_vertices(surface: Surface, indices: ArrayLike, what: str) -> Ints:
    """Return `indices` as a (k,) int32 array of vertices of `surface`, or raise ParameterError."""
    array = np.atleast_1d(np.asarray(indices))
    if array.ndim != 1 or array.size == 0 or not np.issubdtype(array.dtype, np.integer):
        raise ParameterError(f"{what} must be one or more vertex indices, not {array.dtype} of shape {array.shape}")
    count = len(surface.vertices)
    bad = array[(array < 0) | (array >= count)]
    if bad.size:
        raise ParameterError(f"{what}: the mesh has no vertex {bad[0]}, only 0 to {count - 1}")
    return array.astype(np.int32)
