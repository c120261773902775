"""Writing of mesh files."""

from __future__ import annotations

import io
import json
from typing import Any, Final

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.errors import check_choice
from unbend.mesh.formats import WRITTEN
from unbend.mesh.formats.registry import REGISTRY

ALL_FORMATS: Final = (*WRITTEN, "json", "npz")
TEXTURE_FORMATS: Final = ("obj", "glb", "json", "npz")
"""Formats that support texture coordinates."""


def check_format(file_type: str, formats: tuple[str, ...] = ALL_FORMATS) -> str:
    """Return `file_type` if it is one of `formats`, otherwise raise ParameterError, which lists them."""
    check_choice("format", file_type, formats)
    return file_type


def write_mesh(
    vertices: Floats,
    faces: Ints,
    file_type: str,
    *,
    colours: Floats | None = None,
    uv: Floats | None = None,
) -> bytes:
    """Return triangles as the bytes of a file.

    Parameters
    ----------
    vertices : (n, 3) float64
        Only vertices without a face may have coordinates that are not finite. In all formats except npz, these
        coordinates become zero, and so do texture coordinates that are not finite.
    faces : (m, 3) int32
    file_type : str
        "ply", "obj", "off", "glb", "json" (members `vertices` and `faces`) or "npz" (arrays of the same names). ply and
        glb have single precision, the others all digits.
    colours : (n, 3) float64, optional
        Red, green and blue of each vertex, from 0 to 1. Files have 8 bits per colour, obj files four digits, json and
        npz full precision.
    uv : (n, 2) float64, optional
        Texture coordinates of each vertex, for "obj", "glb", "json" and "npz". glb keeps them instead of colours if
        both are given.

    Raises
    ------
    ParameterError
        If the format is none of these.
    """
    check_format(file_type, ALL_FORMATS if uv is None else TEXTURE_FORMATS)
    given = {"vertices": vertices, "faces": faces, "colours": colours, "uv": uv}
    arrays: dict[str, Any] = {name: array for name, array in given.items() if array is not None}
    if file_type == "npz":
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays)
        return buffer.getvalue()
    finite = {name: np.where(np.isfinite(array), array, 0) for name, array in arrays.items()}
    if file_type == "json":
        return json.dumps({name: array.tolist() for name, array in finite.items()}).encode()
    write: Any = REGISTRY[file_type].write
    data: bytes = write(finite["vertices"], faces, finite.get("colours"), finite.get("uv"))
    return data
