"""The scene of a glTF file: which meshes stand in it, and where."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import MeshReadError
from unbend.mesh.formats.gltf_data import item_of


@dataclass(frozen=True)
class Place:
    """A mesh and where it stands."""

    mesh: int
    matrix: Floats
    """(4, 4)"""
    skinned: bool = False
    """Whether it has a skin: its joints place it, not its node."""
    extensions: tuple[str, ...] = ()
    """Names of the extensions of its node."""


def places(layout: dict[str, Any]) -> Iterator[Place]:
    """Yield each mesh and its place, from the root nodes down; where no node has a mesh, yield every mesh once.

    A node has one parent at most, so this ends. The transform of a node does not place a mesh with a skin: its joints
    do (section 3.7.3.3). Such a mesh stays in the pose in which its skin was bound.
    """
    nodes = layout.get("nodes", [])
    if "scenes" not in layout and not any("mesh" in node for node in nodes):
        yield from (Place(mesh, np.eye(4)) for mesh in range(len(layout.get("meshes", []))))
        return
    waiting = [(root, np.eye(4)) for root in reversed(_roots(layout))]
    seen = set()
    while waiting:
        index, above = waiting.pop()
        if index in seen:
            raise MeshReadError(f"node {index} of the glb file stands in two places")
        seen.add(index)
        node = item_of(nodes, index)
        matrix = above @ node_matrix(node)
        waiting += [(child, matrix) for child in reversed(node.get("children", []))]
        if "mesh" in node:
            skinned = "skin" in node
            yield Place(node["mesh"], np.eye(4) if skinned else matrix, skinned, tuple(node.get("extensions", ())))


def _roots(layout: dict[str, Any]) -> list[int]:
    if "scenes" in layout:
        scene = item_of(layout["scenes"], layout.get("scene", 0))
        return list(scene.get("nodes", []))
    nodes = layout.get("nodes", [])
    children = {child for node in nodes for child in node.get("children", [])}
    return [index for index in range(len(nodes)) if index not in children]


def node_matrix(node: dict[str, Any]) -> Floats:
    """Return the transform of a node to its parent, (4, 4): its `matrix`, or its translation, rotation and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    with np.errstate(all="ignore"):  # numbers out of range give coordinates that are not finite; repair reports these
        matrix[:3, :3] = _rotation(node.get("rotation", (0, 0, 0, 1))) * np.reshape(node.get("scale", (1, 1, 1)), 3)
    matrix[:3, 3] = np.reshape(node.get("translation", (0, 0, 0)), 3)
    return matrix


def placed(vertices: Floats, faces: Indices, matrix: Floats) -> tuple[Floats, Indices]:
    """Return a mesh moved by `matrix` (4, 4); if that mirrors, turn its faces around to keep the outside outside."""
    if (matrix == np.eye(4)).all():
        return vertices, faces  # keeps the last digit
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
