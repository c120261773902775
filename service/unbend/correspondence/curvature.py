"""Curvature at two scales, by the heat flow of the cotangent Laplacian."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.sparse import csc_array, dia_array
from scipy.sparse.linalg import splu

from unbend.arrays import Bools, Floats, Ints
from unbend.mesh.surface import Surface

SCALES: Final = (0.03, 0.06)
"""Lengths over which curvature is averaged, over the square root of the area: below and above a wrist's radius."""

_LARGEST_COTANGENT: Final = 10.0
"""Cotangents are clipped from zero to this, so that the system stays well posed on thin triangles."""

_LARGEST: Final = 3.0
"""Curvatures are clipped to this many standard deviations, so that single spikes do not outweigh all else."""


def curvatures(surface: Surface, sign: float) -> Floats:
    """Return the curvatures of a surface, each with mean 0 and standard deviation 1, (n, 4)."""
    values = raw_curvatures(surface, sign, surface.area)
    return standardised(values, values, _shares(surface, surface.area))


def curvatures_of_part(part: Surface, whole: Surface, sign: float, whole_sign: float) -> tuple[Floats, Floats]:
    """Return the curvatures of a piece and of its whole, in the units of the whole."""
    ours, theirs = raw_curvatures(part, sign, whole.area), raw_curvatures(whole, whole_sign, whole.area)
    shares = _shares(whole, whole.area)
    return standardised(ours, theirs, shares), standardised(theirs, theirs, shares)


def raw_curvatures(surface: Surface, sign: float, area: float) -> Floats:
    """Return mean and Gaussian curvature at two scales, where the square root of `area` is 1, (n, 4).

    Mean curvature is the way that a vertex moves along the normal under implicit heat flow (Desbrun et al. 1999), and
    Gaussian curvature the angle missing around it, spread by the same flow. Bending keeps the Gaussian curvature; it
    changes the mean curvature where the surface bends, so matching weighs each by how well it agrees.

    Parameters
    ----------
    surface : Surface
    sign : float
        -1 if the faces show inwards.
    area : float
    """
    unit = np.sqrt(area)
    vertices, faces = surface.vertices / unit, surface.faces
    areas = _areas(surface, area)
    stiffness, angles, normals = _differential(vertices, faces)
    defects = np.where(_on_boundary(surface), np.pi, 2 * np.pi) - angles
    found = []
    for scale in SCALES:
        system = csc_array(dia_array((areas[None], 0), shape=stiffness.shape) + scale**2 * stiffness)
        solve = splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve
        smooth, along = solve(areas[:, None] * vertices), solve(sign * normals)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), np.finfo(np.float64).tiny)
        found += [((vertices - smooth) * along).sum(axis=1), solve(defects)]
    return np.stack(found, axis=1)


def standardised(values: Floats, reference: Floats, shares: Floats) -> Floats:
    """Return values less the mean of `reference`, over its standard deviation, clipped."""
    mean = shares @ reference
    spread = np.sqrt(shares @ (reference - mean) ** 2)
    return np.asarray(np.clip((values - mean) / np.maximum(spread, np.finfo(np.float32).eps), -_LARGEST, _LARGEST))


def _areas(surface: Surface, area: float) -> Floats:
    return np.asarray(np.maximum(surface.vertex_areas / area, np.finfo(np.float32).eps / len(surface.vertices)))


def _shares(surface: Surface, area: float) -> Floats:
    areas = _areas(surface, area)
    return np.asarray(areas / areas.sum())


def _differential(vertices: Floats, faces: Ints) -> tuple[csc_array, Floats, Floats]:
    """Return the stiffness matrix, the angle around and the area-weighted normal of each vertex."""
    count = len(vertices)
    rows, columns, weights = [], [], []
    angles: Floats = np.zeros(count)
    for corner in range(3):
        apex, p, q = faces[:, corner], faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        u, v = vertices[p] - vertices[apex], vertices[q] - vertices[apex]
        along, across = (u * v).sum(axis=1), np.linalg.norm(np.cross(u, v), axis=1)
        angles += np.bincount(apex, np.arctan2(across, along), minlength=count)
        cotangent = along / np.maximum(across, np.finfo(np.float64).tiny)
        rows += [p, q]
        columns += [q, p]
        weights += [np.clip(cotangent, 0.0, _LARGEST_COTANGENT) / 2] * 2
    adjacent = csc_array(
        (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=(count, count)
    )
    stiffness = csc_array(dia_array((adjacent.sum(axis=1)[None], 0), shape=adjacent.shape) - adjacent)
    planes = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(planes[:, axis], 3), minlength=count) for axis in range(3)], axis=1
    )
    return stiffness, angles, np.asarray(normals, np.float64)


def _on_boundary(surface: Surface) -> Bools:
    edges, marked = surface.edges, np.zeros(len(surface.vertices), bool)
    alone = edges.order[edges.starts[edges.counts == 1]]
    for step in (1, 2):
        marked[surface.faces[alone // 3, (alone + step) % 3]] = True
    return marked
