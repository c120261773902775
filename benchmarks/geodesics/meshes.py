"""The meshes that geodesic distances are measured on, and the distances that are known in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.common import DATA
from benchmarks.geodesics.peers import Array
from unbend import Surface, read_mesh
from unbend.mesh.shapes import sphere, torus

REAL = {
    "bunny (3.3 k)": "single/bunny.obj",
    "FAUST (5 k)": "faust5k/tr_reg_000.off",
    "cat (5 k)": "tosca5k/cat0.off",
    "centaur (5 k)": "tosca5k/centaur0.off",
    "human (6.9 k)": "single/human_man.obj",
    "armadillo (14.6 k)": "single/armadillo.obj",
    "fine bunny (29.8 k)": "single/bunny_hr.obj",
}
DETAILED = ["human (6.9 k)", "fine bunny (29.8 k)"]
SHEAR = 1.5


@dataclass(frozen=True)
class Mesh:
    """A mesh and the file of its arrays, which every method loads."""

    name: str
    surface: Surface
    path: Path

    @property
    def count(self) -> int:
        """Number of vertices."""
        return len(self.surface.vertices)

    def spread(self, count: int) -> list[int]:
        """Return up to `count` vertices, evenly spaced in the mesh's own order."""
        return np.unique(np.linspace(0, self.count - 1, count).astype(int)).tolist()


class Folder:
    """Makes meshes and keeps their files."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.number = 0

    def add(self, name: str, surface: Surface) -> Mesh:
        """Write the arrays of `surface`, without vertices that no face uses: some peers drop them or crash."""
        used, faces = np.unique(surface.faces, return_inverse=True)
        surface = Surface(surface.vertices[used], faces.reshape(-1, 3))
        path = self.path / f"{self.number}.npz"
        self.number += 1
        np.savez(path, vertices=surface.vertices, faces=surface.faces)
        return Mesh(name, surface, path)

    def real(self, name: str) -> Mesh:
        """Return the mesh of this name in `REAL`."""
        return self.add(name, read_mesh(DATA / REAL[name]))

    def coarse(self) -> list[Mesh]:
        """Return 30 of SHREC'11's simplified meshes, of 252 vertices each."""
        return [
            self.add(path.stem, read_mesh(path)) for path in sorted((DATA / "shrec11_simplified").glob("*.obj"))[::16]
        ]

    def torus(self, columns: int, rows: int) -> Mesh:
        """Return a torus from a regular grid; half of its triangles are obtuse."""
        return self.add(f"torus grid ({_size(columns * rows)})", torus(columns=columns, rows=rows))

    def sphere(self, subdivisions: int) -> Mesh:
        """Return an icosphere."""
        surface = sphere(subdivisions)
        return self.add(_size(len(surface.vertices)), surface)

    def sheared(self, cells: int) -> Mesh:
        """Return a flat square grid of `cells` x `cells`, sheared: x += SHEAR y."""
        x, y = np.meshgrid(np.arange(cells + 1.0), np.arange(cells + 1.0))
        vertices = np.stack([x + SHEAR * y, y, 0 * x], axis=-1).reshape(-1, 3) / cells
        corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
        right, up, both = corner + 1, corner + cells + 1, corner + cells + 2
        faces = np.concatenate([np.stack([corner, right, both], 1), np.stack([corner, both, up], 1)])
        return self.add(f"{cells} x {cells}", Surface(vertices, faces))

    def subdivided(self, mesh: Mesh, times: int) -> Mesh:
        """Return `mesh` with every triangle split in four at its edges' midpoints, `times` over."""
        surface = mesh.surface
        for _ in range(times):
            surface = _subdivide(surface)
        return self.add(f"{mesh.name.split(' (')[0]}, subdivided ({_size(len(surface.vertices))})", surface)


def great_circles(mesh: Mesh, sources: list[int]) -> Array:
    """Return distances on the unit sphere."""
    vertices = mesh.surface.vertices
    chords = np.linalg.norm(vertices[sources][:, None] - vertices, axis=2)
    return 2 * np.arcsin(np.minimum(1.0, chords / 2))


def straight_lines(mesh: Mesh, sources: list[int]) -> Array:
    """Return distances in a flat convex surface."""
    vertices = mesh.surface.vertices
    return np.linalg.norm(vertices[sources][:, None] - vertices, axis=2)


def _subdivide(surface: Surface) -> Surface:
    count = len(surface.vertices)
    edges = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    unique, inverse = np.unique(edges[:, 0] * count + edges[:, 1], return_inverse=True)
    middles = (surface.vertices[unique // count] + surface.vertices[unique % count]) / 2
    a, b, c = surface.faces.T
    ab, bc, ca = (inverse.reshape(-1, 3) + count).T
    faces = [np.stack(corners, axis=1) for corners in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    return Surface(np.vstack([surface.vertices, middles]), np.vstack(faces))


def _size(count: int) -> str:
    if count < 1000:
        return str(count)
    return f"{count / 1e6:.3g} M" if count >= 1e6 else f"{count / 1e3:.3g} k"
