"""Generators of mesh files for schemathesis, because OpenAPI describes only their media types.

schemathesis loads this module, as its configuration says.
"""

from __future__ import annotations

import numpy as np
import schemathesis
import trimesh
from hypothesis import strategies as st

from tests.support.server import DAMAGED
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

FILE_TYPES = {
    "model/vnd.off": "off",
    "model/obj": "obj",
    "application/vnd.ply": "ply",
    "model/stl": "stl",
    "model/gltf-binary": "glb",
}


def tetrahedron(height: int) -> trimesh.Trimesh:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, height]], float)
    return trimesh.Trimesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], process=False)


def ring(number: int) -> trimesh.Trimesh:
    surface = torus(minor=0.2 + 0.01 * number, columns=10, rows=6)
    return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


def as_file(mesh: trimesh.Trimesh, file_type: str) -> bytes:
    if file_type == "stl":  # unbend does not write stl
        return bytes(mesh.export(file_type="stl"))
    return write_mesh(mesh.vertices, mesh.faces, file_type)


def files(file_type: str) -> st.SearchStrategy[bytes]:
    """Generate few different meshes of a format, so that some are sent repeatedly.

    For off, also generate a damaged file, whose damage is found only when its job runs.
    """
    numbers = st.integers(1, 12)
    whole = (numbers.map(tetrahedron) | numbers.map(ring)).map(lambda mesh: as_file(mesh, file_type))
    return whole | st.just(DAMAGED) if file_type == "off" else whole


for media_type, file_type in FILE_TYPES.items():
    schemathesis.openapi.media_type(media_type, files(file_type))
