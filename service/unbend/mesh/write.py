"""Writing triangles as a file."""

from __future__ import annotations

import io
import json
from typing import Final

import numpy as np
import trimesh

from unbend.arrays import Floats, Ints
from unbend.errors import ParameterError

MESH_FORMATS: Final = ("ply", "obj", "off", "glb")
ALL_FORMATS: Final = (*MESH_FORMATS, "json", "npz")


def check_format(file_type: str) -> str:
    """Return `file_type` if it can be written; ParameterError names those that can."""
    if file_type not in ALL_FORMATS:
        raise ParameterError(f"format must be one of {', '.join(ALL_FORMATS)}, not {file_type!r}")
    return file_type


def write_mesh(vertices: Floats, faces: Ints, file_type: str) -> bytes:
    """Return triangles as the bytes of a file.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
    file_type : str
        "ply", "obj", "off", "glb", "json" (members `vertices` and `faces`) or "npz" (arrays of those names).

    Raises
    ------
    ParameterError
        If the format is none of those.
    """
    check_format(file_type)
    if file_type == "json":
        finite = np.where(np.isfinite(vertices), vertices, 0.0)  # only vertices without a face may be otherwise
        return json.dumps({"vertices": finite.tolist(), "faces": faces.tolist()}).encode()
    if file_type == "npz":
        buffer = io.BytesIO()
        np.savez_compressed(buffer, vertices=vertices, faces=faces)
        return buffer.getvalue()
    data = trimesh.Trimesh(vertices, faces, process=False).export(file_type=file_type)
    return data.encode() if isinstance(data, str) else bytes(data)
