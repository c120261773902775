"""All methods of geodesic distances with one protocol: load, prepare once, then compute rows of distances.

A library is imported when its method is created, so that a process loads only the library it measures.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

Array = np.ndarray
Rows = Callable[[Any, Sequence[int], int | None], Array]
"""Takes the prepared state, sources and a number of threads."""


@dataclass(frozen=True)
class Method:
    """A method of geodesic distances; without a call for many sources, it takes them one after the other."""

    prepare: Callable[[Any], Any]
    """Takes the mesh that `load` returns, and returns the state that is computed once for a mesh."""
    row: Callable[[Any, int], Array]
    """Takes the prepared state and a source, and returns distances to every vertex, (n,)."""
    load: Callable[[Array, Array], Any] = lambda vertices, faces: (vertices, faces)
    """Takes vertices and faces, and returns the mesh for `prepare`; its time is not measured."""
    rows_in_one_call: Rows | None = None
    matrix_in_one_call: Rows | None = None

    def rows(self, state: Any, sources: Sequence[int], threads: int | None) -> Array:
        """Return distances from each of `sources`, (k, n)."""
        if self.rows_in_one_call:
            return self.rows_in_one_call(state, sources, threads)
        return np.array([self.row(state, source) for source in sources])

    def matrix(self, state: Any, samples: Sequence[int], threads: int | None) -> Array:
        """Return the symmetric matrix of distances between `samples`."""
        if self.matrix_in_one_call:
            return self.matrix_in_one_call(state, samples, threads)
        distances = np.array([self.row(state, sample)[samples] for sample in samples])
        return np.minimum(distances, distances.T)


def unbend(update: str) -> Method:
    """Return unbend's method; its first call builds the stencils and caches them on the surface."""
    library = import_module("unbend")

    def rows(surface: Any, sources: Sequence[int], threads: int | None) -> Array:
        return library.geodesic_distances(surface, sources, update=update, threads=threads)

    def prepare(surface: Any) -> Any:
        rows(surface, [0], 1)
        return surface

    def matrix(surface: Any, samples: Sequence[int], threads: int | None) -> Array:
        return library.geodesic_matrix(surface, samples, update=update, threads=threads)

    return Method(prepare, lambda surface, source: rows(surface, [source], 1)[0], library.Surface, rows, matrix)


def potpourri_marching() -> Method:
    """Return geometry-central's fast marching."""
    library = import_module("potpourri3d")
    return Method(
        lambda mesh: library.MeshFastMarchingDistanceSolver(*mesh),
        lambda solver, source: solver.compute_distance([[(int(source), [])]]),
    )


def potpourri_heat() -> Method:
    """Return geometry-central's heat method, on an intrinsic Delaunay triangulation (its default)."""
    library = import_module("potpourri3d")
    return Method(
        lambda mesh: library.MeshHeatMethodDistanceSolver(*mesh),
        lambda solver, source: solver.compute_distance(int(source)),
    )


def igl_heat() -> Method:
    """Return libigl's heat method with its intrinsic Delaunay triangulation enabled.

    With libigl's default (disabled), rows take as long, and mean errors reach 15 % on real meshes.
    """
    library = import_module("igl")

    def prepare(mesh: Any) -> Any:
        data = library.HeatGeodesicsData()
        data.use_intrinsic_delaunay = True
        library.heat_geodesics_precompute(mesh[0], mesh[1].astype(np.int64), data)
        return data

    return Method(prepare, lambda data, source: library.heat_geodesics_solve(data, np.array([source], np.int64)))


def igl_exact() -> Method:
    """Return libigl's exact geodesics, a single function that repeats the preparation in every call."""
    library = import_module("igl")
    none = np.empty(0, np.int64)
    return Method(
        lambda mesh: (mesh[0], mesh[1].astype(np.int64), np.arange(len(mesh[0]), dtype=np.int64)),
        lambda mesh, source: library.exact_geodesic(
            mesh[0], mesh[1], np.array([source], np.int64), none, mesh[2], none
        ),
    )


def meshlib_marching() -> Method:
    """Return MeshLib's computeSurfaceDistances: fast marching in single precision."""
    library, arrays = import_module("meshlib.mrmeshpy"), import_module("meshlib.mrmeshnumpy")

    def row(mesh: Any, source: int) -> Array:
        start = library.VertBitSet(int(source) + 1, False)
        start.set(library.VertId(int(source)))
        scalars = library.computeSurfaceDistances(mesh, start)
        # MeshLib's own conversions of VertScalars copy value by value, which takes as long as the marching, or longer.
        pointer = ctypes.cast(scalars.vec.data_pointer(), ctypes.POINTER(ctypes.c_float))
        return np.ctypeslib.as_array(pointer, (scalars.size(),)).astype(np.float64)

    return Method(lambda mesh: arrays.meshFromFacesVerts(mesh[1], mesh[0]), row)


def scipy_dijkstra() -> Method:
    """Return SciPy's shortest paths along the edges."""
    sparse, dijkstra = import_module("scipy.sparse"), import_module("scipy.sparse.csgraph").dijkstra

    def prepare(mesh: Any) -> Any:
        vertices, faces = mesh
        edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
        lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        graph = sparse.coo_array((lengths, tuple(edges.T)), shape=(len(vertices), len(vertices)))
        return (graph + graph.T).tocsr()

    def rows(graph: Any, sources: int | Sequence[int], _threads: int | None = None) -> Array:
        return dijkstra(graph, indices=sources)

    return Method(prepare, rows, rows_in_one_call=rows)


def pygeodesic_exact() -> Method:
    """Return Kirsanov's exact geodesics (Mitchell, Mount, Papadimitriou), the reference for all errors."""
    library = import_module("pygeodesic.geodesic")

    def row(algorithm: Any, source: int) -> Array:
        distances, _ = algorithm.geodesicDistances(np.array([source]))
        if distances is None:  # pygeodesic prints its errors instead of raising them
            raise ValueError("no distances")
        return distances

    return Method(lambda mesh: library.PyGeodesicAlgorithmExact(*mesh), row)


PLANAR, SPHERICAL, EXACT, SLOW_EXACT = "unbend planar", "unbend spherical", "pygeodesic exact", "libigl exact"
METHODS: dict[str, Callable[[], Method]] = {
    PLANAR: lambda: unbend("planar"),
    SPHERICAL: lambda: unbend("spherical"),
    "potpourri3d FMM": potpourri_marching,
    "potpourri3d heat": potpourri_heat,
    "libigl heat": igl_heat,
    "MeshLib FMM": meshlib_marching,
    "SciPy Dijkstra": scipy_dijkstra,
    EXACT: pygeodesic_exact,
    SLOW_EXACT: igl_exact,
}
OURS = [PLANAR, SPHERICAL]
EXACTS = [EXACT, SLOW_EXACT]
APPROXIMATE = [name for name in METHODS if name not in EXACTS]
PEERS = [name for name in METHODS if name not in OURS]
PACKAGES = ["potpourri3d", "libigl", "meshlib", "scipy", "pygeodesic"]
