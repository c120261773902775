"""A shape as one file for viewers: its surface, its signature, and the numbers of its vertices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from unbend.arrays import Floats, Indices, Ints, positions_of
from unbend.errors import MeshGeometryError
from unbend.mesh.formats import gltf_writing
from unbend.mesh.simplify import simplify
from unbend.mesh.surface import Surface
from unbend.render.picture import form_in_space
from unbend.render.upright import upright_axis
from unbend.signature.canonical_form import CanonicalForm, canonical_form
from unbend.signature.signature import Signature

MOST_FACES: Final = 60_000
"""Number of faces above which a view is simplified, by default: enough for a screen, and computed in seconds."""

_SHOWN_DIMENSIONS: Final = 6


@dataclass(frozen=True, eq=False)
class Display:
    """A surface for viewing, perhaps simplified, with its signature at every vertex."""

    vertices: Floats
    """Its vertices around `centre`, (k, 3), in the unit of the file."""
    faces: Ints
    """Its triangles, (f, 3)."""
    form: Floats
    """The canonical form of its vertices, (k, 3 or more), in the unit and the orientation of the surface."""
    dimensions: int
    """Dimensions of the signature."""
    numbers: Indices
    """For each vertex here, its number in the file, (k,)."""
    centre: Floats
    """The point of the file that is the origin here, (3,)."""
    up: Literal["y", "z"]
    """The upright axis of the surface."""
    full_faces: int
    """Faces of the surface before simplification."""

    def as_glb(self) -> bytes:
        """Return a glb file with the attributes `_FORM`, `_VERTEX` and, above three dimensions, `_MORE`."""
        extra = {"_FORM": _columns(self.form, 0), "_VERTEX": self.numbers[:, None].astype(np.float64)}
        if self.form.shape[1] > 3:
            extra["_MORE"] = _columns(self.form, 3)
        about = {
            "centre": self.centre.tolist(),
            "dimensions": self.dimensions,
            "up": self.up,
            "faces": len(self.faces),
            "full_faces": self.full_faces,
        }
        return gltf_writing.write(self.vertices, self.faces, None, None, extra=extra, about=about)


def display(surface: Surface, signature: Signature, most_faces: int = MOST_FACES) -> Display:
    """Return a surface for viewing, simplified to about `most_faces` faces, with its signature.

    Parameters
    ----------
    surface : Surface
    signature : Signature
        The signature of `surface`.
    most_faces : int

    Raises
    ------
    MeshGeometryError
        If the surface cannot be simplified that far.
    """
    shown, form, chosen = simplified_form(surface, signature, most_faces)
    low, high = shown.vertices.min(axis=0), shown.vertices.max(axis=0)
    centre = (low + high) / 2
    points = np.hstack([form_in_space(form, shown), form.points[:, 3:] * signature.scale])
    return Display(
        shown.vertices - centre, shown.faces, points, form.points.shape[1], _numbers(surface)[chosen], centre,
        upright_axis(shown), len(surface.faces),
    )  # fmt: skip


def simplified_form(surface: Surface, signature: Signature, most_faces: int) -> tuple[Surface, CanonicalForm, Indices]:
    """Return `surface` simplified to about `most_faces` faces, its canonical form, and the old vertex at each new one.

    The canonical form is that of the simplified surface: simplification hardly changes geodesic distances, and the
    cost of the form does not grow with the size of `surface`.

    Raises
    ------
    MeshGeometryError
        If the surface cannot be simplified that far.
    """
    shown, chosen = _simplified(surface, most_faces)
    moved = _moved(signature, surface, shown, chosen)
    try:
        return shown, canonical_form(shown, signature=moved, threads=1), chosen
    except MeshGeometryError:  # simplification separated parts that only a vertex connected
        points = canonical_form(surface, signature=signature, threads=1).points[chosen]
        return shown, CanonicalForm(points, shown.faces, moved), chosen


def _simplified(surface: Surface, most_faces: int) -> tuple[Surface, Indices]:
    """Return the surface without unused vertices, simplified if it is large, and the old vertex at each new one."""
    if len(surface.faces) <= most_faces:
        used = surface.used_vertices
        faces = positions_of(used, len(surface.vertices))[surface.faces]
        return Surface(surface.vertices[used], faces), used
    found = simplify(surface, max(4, most_faces // 2))
    merged = np.flatnonzero(found.vertex_map >= 0)
    into = found.vertex_map[merged]
    away = ((surface.vertices[merged] - found.vertices[into]) ** 2).sum(axis=1)
    nearest = np.lexsort((away, into))  # by new vertex, the nearest old vertex first
    chosen = merged[nearest][np.searchsorted(into[nearest], np.arange(len(found.vertices)))]
    # New vertices take the places of old vertices, so that distances and paths on `surface` begin and end there.
    return Surface(surface.vertices[chosen], found.faces), chosen


def _moved(signature: Signature, surface: Surface, shown: Surface, chosen: Indices) -> Signature:
    """Return the signature with its samples at vertices of the simplified surface."""
    samples = positions_of(chosen, len(surface.vertices))[signature.samples]
    for sample in np.flatnonzero(samples < 0):
        away = ((shown.vertices - surface.vertices[signature.samples[sample]]) ** 2).sum(axis=1)
        samples[sample] = int(away.argmin())
    _, kept = np.unique(samples, return_index=True)
    kept.sort()
    return replace(
        signature, points=signature.points[kept], samples=samples[kept], weights=signature.weights[kept],
        faces=np.empty((0, 3), np.int32),
    )  # fmt: skip


def _numbers(surface: Surface) -> Indices:
    """Return the first vertex of the file at each vertex of the surface."""
    if surface.vertex_map is None:
        return np.arange(len(surface.vertices))
    numbers = np.zeros(len(surface.vertices), np.int64)
    there = np.flatnonzero(surface.vertex_map >= 0)[::-1]  # the last assignment wins
    numbers[surface.vertex_map[there]] = there
    return numbers


def _columns(form: Floats, start: int) -> Floats:
    """Return three columns of the form, zero where it has fewer."""
    part = form[:, start : min(start + 3, _SHOWN_DIMENSIONS)]
    return np.hstack([part, np.zeros((len(part), 3 - part.shape[1]))])
