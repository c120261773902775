"""Writing triangles as a file."""

from __future__ import annotations

import io
import json
from typing import Any, Final

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.errors import ParameterError
from unbend.mesh.formats.registry import REGISTRY

MESH_FORMATS: Final = ("ply", "obj", "off", "glb")
ALL_FORMATS: Final = (*MESH_FORMATS, "json", "npz")
TEXTURE_FORMATS: Final = ("obj", "glb", "json", "npz")
"""Those that hold texture coordinates."""


def check_format(file_type: str, formats: tuple[str, ...] = ALL_FORMATS) -> str:
    """Return `file_type` if it is one of `formats`; ParameterError names those."""
    if file_type not in formats:
        raise ParameterError(f"format must be one of {', '.join(formats)}, not {file_type!r}")
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
        Coordinates that are not finite, which only vertices without a face may have, are written as zero in all
        formats but npz; so are those of `uv`.
    faces : (m, 3) int32
    file_type : str
        "ply", "obj", "off", "glb", "json" (members `vertices` and `faces`) or "npz" (arrays of those names). ply and
        glb keep single precision, the others all digits.
    colours : (n, 3) float64, optional
        Red, green and blue of each vertex, from 0 to 1; 8 bits of each are kept, four digits in obj, all in json
        and npz.
    uv : (n, 2) float64, optional
        Texture coordinates of each vertex, for "obj", "glb", "json" and "npz". glb keeps them, not the
        colours, where there are both.

    Raises
    ------
    ParameterError
        If the format is none of those.
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
