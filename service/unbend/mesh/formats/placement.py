"""Where nodes of a glTF scene put their meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from unbend.arrays import Floats, Indices


def node_matrix(node: dict[str, Any]) -> Floats:
    """Return the transform of a node to its parent, (4, 4): its `matrix`, or its translation, rotation and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    with np.errstate(all="ignore"):  # numbers out of range become coordinates that are not finite, and are told so
        matrix[:3, :3] = _rotation(node.get("rotation", (0, 0, 0, 1))) * np.reshape(node.get("scale", (1, 1, 1)), 3)
    matrix[:3, 3] = np.reshape(node.get("translation", (0, 0, 0)), 3)
    return matrix


def placed(vertices: Floats, faces: Indices, matrix: Floats) -> tuple[Floats, Indices]:
    """Return a mesh moved by `matrix`; one that mirrors turns faces around, so that their outside stays outside."""
    if (matrix == np.eye(4)).all():
        return vertices, faces  # to the last digit
    with np.errstate(all="ignore"):
        moved = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        return moved, faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else faces


def _rotation(quaternion: Any) -> Floats:
    x, y, z, w = np.array(quaternion, np.float64)
    norm = x * x + y * y + z * z + w * w
    if norm == 0:
        return np.eye(3)
    rotation: Floats = np.eye(3) + 2 / norm * np.array([
        [-y * y - z * z, x * y - z * w, x * z + y * w],
        [x * y + z * w, -x * x - z * z, y * z - x * w],
        [x * z - y * w, y * z + x * w, -x * x - y * y],
    ])  # fmt: skip
    return rotation
