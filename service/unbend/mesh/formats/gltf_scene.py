"""The scene of a glTF file: instances of meshes, placed by nodes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import MeshReadError
from unbend.mesh.formats.gltf_data import item_of


@dataclass(frozen=True)
class Instance:
    """A mesh in the scene, and the transform that places it."""

    mesh: int
    matrix: Floats
    """(4, 4)"""
    skinned: bool = False
    """Whether the mesh has a skin. Joints, not the node, place such a mesh."""
    extensions: tuple[str, ...] = ()
    """Names of the extensions of the node."""


def instances(gltf: dict[str, Any]) -> Iterator[Instance]:
    """Yield the instances of the default scene, from the root nodes down.

    If the file has no scenes, all nodes without a parent are roots. If no node has a mesh either, each mesh is an
    instance. The search ends, because a node that is reached twice is an error.

    Joints, not the node's transform, place a mesh with a skin (section 3.7.3.3). Such a mesh stays in its bind pose.
    """
    nodes = gltf.get("nodes", [])
    if "scenes" not in gltf and not any("mesh" in node for node in nodes):
        yield from (Instance(mesh, np.eye(4)) for mesh in range(len(gltf.get("meshes", []))))
        return
    waiting = [(root, np.eye(4)) for root in reversed(_roots(gltf))]
    seen = set()
    while waiting:
        index, above = waiting.pop()
        if index in seen:
            raise MeshReadError(f"node {index} of the glb file occurs twice in the scene")
        seen.add(index)
        node = item_of(nodes, index)
        matrix = above @ node_matrix(node)
        waiting += [(child, matrix) for child in reversed(node.get("children", []))]
        if "mesh" in node:
            skinned = "skin" in node
            yield Instance(node["mesh"], np.eye(4) if skinned else matrix, skinned, tuple(node.get("extensions", ())))


def _roots(gltf: dict[str, Any]) -> list[int]:
    if "scenes" in gltf:
        scene = item_of(gltf["scenes"], gltf.get("scene", 0))
        return list(scene.get("nodes", []))
    nodes = gltf.get("nodes", [])
    children = {child for node in nodes for child in node.get("children", [])}
    return [index for index in range(len(nodes)) if index not in children]


def node_matrix(node: dict[str, Any]) -> Floats:
    """Return the transform of a node to its parent, (4, 4): its `matrix`, or its translation, rotation and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    with np.errstate(all="ignore"):  # overflow gives coordinates that are not finite, which repair reports
        matrix[:3, :3] = _rotation(node.get("rotation", (0, 0, 0, 1))) * np.reshape(node.get("scale", (1, 1, 1)), 3)
    matrix[:3, 3] = np.reshape(node.get("translation", (0, 0, 0)), 3)
    return matrix


def transformed(vertices: Floats, faces: Indices, matrix: Floats) -> tuple[Floats, Indices]:
    """Return a mesh transformed by `matrix` (4, 4). If that mirrors it, reverse the faces to keep their front."""
    if (matrix == np.eye(4)).all():
        return vertices, faces  # without rounding
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
