"""Flattening: texture coordinates from the canonical form in the plane (Zigelman et al. 2002; the paper's Fig. 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from unbend.arrays import Floats, frozen
from unbend.brief import brief, counted
from unbend.mesh.surface import Surface
from unbend.mesh.write import write_mesh
from unbend.signature.canonical_form import canonical_form
from unbend.signature.parameters import Parameters
from unbend.tolerances import DEGENERATE_HEIGHT


@dataclass(frozen=True, eq=False)
class Flattening:
    """A surface mapped to the plane, with texture coordinates for each vertex."""

    uv: Floats
    """Texture coordinates, (n, 2), from 0 to 1 along the longer side and from 0 along the other side. NaN at vertices
    that no face uses."""
    scale: float
    """Length in the unit of the surface that corresponds to 1 in `uv`, along both axes."""
    stretches: Floats
    """Singular values of the map from each triangle to the plane, with the same unit in both, (f, 2). The larger comes
    first; the smaller is negative if the triangle is flipped. Both are 1 for an isometry, and NaN for degenerate
    triangles."""
    stress: float
    """Eq. 2 of the samples."""
    surface: Surface
    """The surface that was flattened."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "uv", frozen(self.uv, np.float64))
        object.__setattr__(self, "stretches", frozen(self.stretches, np.float64))

    def __repr__(self) -> str:
        return brief(
            self, counted(len(self.uv), "vertex", "vertices"), counted(len(self.stretches), "face"),
            f"stress {self.stress:.3g}",
        )  # fmt: skip

    @cached_property
    def distortion(self) -> Floats:
        """Largest factor by which a length in each triangle grows or shrinks, (f,), from `stretches`."""
        with np.errstate(divide="ignore"):
            return frozen(np.maximum(self.stretches[:, 0], 1 / np.abs(self.stretches[:, 1])), np.float64)

    @property
    def mean_distortion(self) -> float:
        """Mean of `distortion` over the area: 1 for an isometry, infinite if a triangle collapses."""
        return self._area_mean(self.distortion)

    @property
    def max_distortion(self) -> float:
        """Maximum of `distortion`."""
        return float(np.nanmax(self.distortion, initial=1.0))

    @property
    def flipped(self) -> float:
        """Share of the area in flipped triangles, 0 to 0.5.

        It is near 0.5 for closed surfaces, which become two layers unless they are cut open first. It means little if
        neighbouring faces have different orientations.
        """
        return self._area_mean((self.stretches[:, 1] < 0).astype(np.float64))

    def _area_mean(self, values: Floats) -> float:
        known = np.isfinite(self.stretches[:, 0]) & (self.surface.face_areas > 0)
        return float(np.average(values[known], weights=self.surface.face_areas[known])) if known.any() else 1.0


def flatten(surface: Surface, parameters: Parameters | None = None, *, threads: int | None = None) -> Flattening:
    """Map a surface to the plane so that distances in the plane approximate geodesic distances.

    The result is the canonical form in two dimensions (`canonical_form`), mirrored if needed so that most of the
    surface shows its front. The surface is not cut, and folds are not prevented. Developable surfaces have no
    distortion, other sheets have little, and closed surfaces become two layers.

    Parameters
    ----------
    surface : Surface
        Its faces must be connected, and should have consistent orientation.
    parameters : Parameters, optional
        `Parameters()` by default. `dimensions` and `scaling` are ignored.
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    Flattening
        The same for the same input on every run.

    Raises
    ------
    MeshGeometryError
        If the surface has no area, or its faces are not connected.
    ParameterError
        If `threads` is below 1.
    """
    chosen = replace(parameters or Parameters(), dimensions=2, scaling="area")
    form = canonical_form(surface, chosen, threads=threads)
    flat = _front_up(form.points, surface)
    corner, far = np.nanmin(flat, axis=0), np.nanmax(flat, axis=0)
    side = float((far - corner).max()) or 1.0
    unit = form.signature.scale
    stretches = _stretches(surface, flat * (unit / surface.scale))
    return Flattening((flat - corner) / side, side * unit, stretches, form.signature.stress, surface)


def export_flattening(flattening: Flattening, file_type: str) -> bytes:
    """Return the bytes of a file with the original surface and its texture coordinates.

    Parameters
    ----------
    flattening : Flattening
    file_type : str
        "obj" (`vt`), "glb" (`TEXCOORD_0`), "json" or "npz" (member `uv`).

    Raises
    ------
    ParameterError
        If the format is none of these.
    """
    return write_mesh(flattening.surface.vertices, flattening.surface.faces, file_type, uv=flattening.uv)


def _front_up(points: Floats, surface: Surface) -> Floats:
    """Return points of the plane, mirrored if otherwise most of the surface's area would show its back."""
    a, b, c = points[surface.faces].transpose(1, 0, 2)
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    front = float(np.sign(ux * vy - uy * vx) @ surface.face_areas)
    return np.asarray(points * np.array([1.0, -1.0 if front < 0 else 1.0]))


def _stretches(surface: Surface, flat: Floats) -> Floats:
    """Return the singular values of the affine map of each triangle, the second with the sign of the determinant.

    The first edge of each triangle defines its x axis. `flat` is in units of `surface.scale`.
    """
    a, b, c = (surface.vertices[surface.faces] / surface.scale).transpose(1, 0, 2)
    first, second = b - a, c - a
    base = np.linalg.norm(first, axis=1)
    height_area = np.linalg.norm(np.cross(first, second), axis=1)
    longest = np.maximum(np.maximum(base, np.linalg.norm(second, axis=1)), np.linalg.norm(c - b, axis=1))
    thin = height_area <= DEGENERATE_HEIGHT * longest**2
    a2, b2, c2 = flat[surface.faces].transpose(1, 0, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (b2 - a2) / base[:, None]
        across = ((c2 - a2) - along * ((first * second).sum(axis=1) / base)[:, None]) * (base / height_area)[:, None]
        (p, q), (r, s) = along.T, across.T
        same, other = np.hypot(p + s, q - r), np.hypot(p - s, q + r)
        values: Floats = np.stack([same + other, same - other], axis=1) / 2
    values[thin] = np.nan
    return values
