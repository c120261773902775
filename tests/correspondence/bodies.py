"""Bodies and pieces for tests of correspondences."""

from __future__ import annotations

import numpy as np

from unbend import Surface, transfer
from unbend.mesh.components import largest_component
from unbend.mesh.shapes import ellipsoid

BUMPS = (((0.9, 0.2, 0.1), 0.5), ((-0.3, 0.6, 0.3), 0.35), ((-0.6, -0.3, -0.35), 0.25))


def blob() -> Surface:
    """A body with three different bumps, which is equal to none of its rotations and mirror images."""
    body = ellipsoid((1.0, 0.75, 0.5), subdivisions=4)
    away = [1.0 + height * np.exp(-((body.vertices - place) ** 2).sum(axis=1) / 0.1) for place, height in BUMPS]
    return Surface(body.vertices * np.prod(away, axis=0)[:, None], body.faces)


def knobbly() -> Surface:
    """A body with many bumps of different heights and widths, so that each place looks different."""
    body, generator = ellipsoid((1.0, 0.75, 0.5), subdivisions=4), np.random.default_rng(0)
    heights: np.ndarray = np.ones(len(body.vertices))
    for centre in generator.choice(len(body.vertices), 24, replace=False):
        squared = ((body.vertices - body.vertices[centre]) ** 2).sum(axis=1)
        heights *= 1.0 + generator.uniform(0.15, 0.5) * np.exp(-squared / generator.uniform(0.02, 0.08))
    return Surface(body.vertices * heights[:, None], body.faces)


def bent(body: Surface) -> Surface:
    """Wind the longest axis of a body along an arc of a circle."""
    x, y, z = body.vertices.T
    radius = 3.0
    return Surface(
        np.stack([(radius + y) * np.sin(x / radius), (radius + y) * np.cos(x / radius), z], axis=1), body.faces
    )


def cut(body: Surface, values: np.ndarray, share: float) -> tuple[Surface, np.ndarray]:
    """Keep the faces of the lowest values, a share of the area; return the piece, and the number of each vertex."""
    order = np.argsort(values[body.faces].mean(axis=1), kind="stable")
    area = np.cumsum(body.face_areas[order])
    kept, _, _ = largest_component(Surface(body.vertices, body.faces[order[area <= share * area[-1]]]))
    used, corners = np.unique(kept, return_inverse=True)
    return Surface(body.vertices[used], corners.reshape(-1, 3)), used


def errors(found, target: Surface, truth: np.ndarray) -> np.ndarray:
    """Straight distances from the matched points to the true points, over the square root of the area."""
    places = transfer(found, target.vertices)
    return np.linalg.norm(places - truth, axis=1) / np.sqrt(target.area)
