"""Articulated figures in any number of poses: nearly isometric within a kind, different between kinds."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from unbend.arrays import Floats
from unbend.errors import ParameterError
from unbend.mesh.shapes.bestiary import SKELETONS
from unbend.mesh.shapes.checks import at_least, one_of, positive
from unbend.mesh.shapes.implicit import BlendedCones
from unbend.mesh.shapes.nets import largest_component, relaxed, surface_net, triangulated
from unbend.mesh.shapes.skeleton import Skeleton
from unbend.mesh.surface import Surface

FIGURES: tuple[str, ...] = tuple(SKELETONS)
"""The kinds that `figure` knows."""

DEFAULT_RESOLUTION = 2000

CANDIDATES = 5
"""Number of random poses tried before an error. At the default resolution nearly every first pose is valid."""


def figure(
    kind: str, pose: int = 0, *, resolution: int = DEFAULT_RESOLUTION, scale: float = 1.0, seed: int = 0
) -> Surface:
    """Return an articulated figure in one of its poses.

    The skin is the zero set of the blended signed distances of the skeleton's rounded cones, polygonised by surface
    nets. Joints turn at the centres of balls, so the skin's area and geodesic distances hardly depend on the pose.
    Limbs stay apart, so every pose is topologically a sphere.

    Parameters
    ----------
    kind : str
        One of `FIGURES`.
    pose : int, default 0
        0 is the rest pose. Every other number, up to 2^31, is a random pose within the limits of the joints. In the
        rare case that limbs would merge on the grid, the pose is drawn again.
    resolution : int, default 2000
        Approximate number of vertices, from 1,500 to 100,000.
    scale : float, default 1.0
        Factor of all coordinates. At 1.0 a figure measures one to three units.
    seed : int, default 0
        Number of the series of poses.

    Returns
    -------
    Surface
        Closed and 2-manifold, of Euler characteristic 2, with outward normals.

    Raises
    ------
    ParameterError
        If there is no such kind, another argument is out of its range, or the resolution is too low for the thinnest
        parts of the figure.
    """
    skeleton = SKELETONS[one_of("kind", kind, FIGURES)]
    pose, seed = at_least("pose", pose, 0, 2**31), at_least("seed", seed, 0, 2**31)
    cell = _cell(skeleton.skin, at_least("resolution", resolution, 1500, 100_000))
    positive("scale", scale)
    for cones in _candidates(skeleton, [seed, FIGURES.index(kind), pose]):
        surface = _skin(cones, cell)
        if surface is not None:
            return Surface(scale * surface.vertices, surface.faces)
    raise ParameterError(f"resolution {resolution} is too low for the {kind}")


def _candidates(skeleton: Skeleton, seeds: list[int]) -> Iterator[BlendedCones]:
    """Yield the rest pose if the last seed is 0, otherwise a few random poses from these seeds."""
    if seeds[-1] == 0:
        yield skeleton.rest()
        return
    # Two thirds of a cell of the default grid, so that a pose does not depend on the resolution.
    clearance = 0.66 * _cell(skeleton.skin, DEFAULT_RESOLUTION)
    generator = np.random.default_rng(seeds)
    for _ in range(CANDIDATES):
        yield skeleton.random_pose(generator, clearance=clearance)


def _cell(skin: float, resolution: int) -> float:
    """Return the cell size for about `resolution` vertices. A net has about 1.5 vertices per squared cell of area."""
    return math.sqrt(1.5 * skin / resolution)


def _skin(cones: BlendedCones, cell: float) -> Surface | None:
    """Return the surface of the cones, or None if the grid is too coarse to give a single sphere."""
    origin, shape = _box(cones, cell)
    points = origin + cell * np.indices(shape).reshape(3, -1).T
    values = cones.distance(points).reshape(shape)
    vertices, quads, solids = largest_component(*surface_net(values, origin, cell))
    vertices = relaxed(vertices, quads, cones.gradient, cell)
    surface = Surface(vertices, triangulated(vertices, quads))
    return surface if solids == 1 and _is_sphere(surface) else None


def _box(cones: BlendedCones, cell: float) -> tuple[Floats, tuple[int, int, int]]:
    """Return the origin and the shape of a grid that contains the cones and two cells around them."""
    reach = cones.radii.max(axis=1)[:, None]
    low = np.minimum(cones.starts, cones.ends) - reach
    high = np.maximum(cones.starts, cones.ends) + reach
    origin = low.min(axis=0) - 2.5 * cell
    x, y, z = np.ceil((high.max(axis=0) - origin) / cell).astype(int) + 3
    return origin, (int(x), int(y), int(z))


def _is_sphere(surface: Surface) -> bool:
    """Return whether every edge occurs once in each direction, and the Euler characteristic is 2."""
    faces, count = surface.faces.astype(np.int64), len(surface.vertices)
    directed = (faces * count + np.roll(faces, -1, axis=1)).ravel()
    opposite = (np.roll(faces, -1, axis=1) * count + faces).ravel()
    paired = np.array_equal(np.sort(directed), np.sort(opposite)) and len(np.unique(directed)) == len(directed)
    return paired and count - len(directed) // 2 + len(faces) == 2
