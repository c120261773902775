"""Correspondences as files: arrays for programs, coloured meshes for viewers."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats
from unbend.correspondence.correspondence import Correspondence
from unbend.correspondence.transfer import transfer
from unbend.mesh.correspondence import at_file_vertices, file_vertices
from unbend.mesh.surface import Surface
from unbend.mesh.write import check_format, write_mesh


def export_correspondence(found: Correspondence, a: Surface, b: Surface, file_type: str) -> bytes:
    """Return `found`, from `match(a, b)`, as bytes.

    Parameters
    ----------
    found : Correspondence
    a, b : Surface
    file_type : str
        "json" or "npz": for each vertex of the file of `a`: `corners` (n, 3), the corners of the face of `b` with its
        point, as vertices of the file of `b`; `barycentric` (n, 3), the weights of these corners; and `confidence`
        (n,). Also `residual`, `oriented` and `ambiguous`. Corners are -1 and weights 0 at vertices without a point.
        "ply", "obj", "off" or "glb": `a` with the colours of `b` (`place_colours`), grey where there is no point.

    Raises
    ------
    ParameterError
        If the format is none of these.
    """
    if check_format(file_type) not in {"json", "npz"}:
        return write_mesh(a.vertices, a.faces, file_type, colours=_carried(found, place_colours(b)))
    arrays = correspondence_arrays(found, a, b)
    if file_type == "json":
        return json.dumps({name: np.asarray(array).tolist() for name, array in arrays.items()}).encode()
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def correspondence_arrays(found: Correspondence, a: Surface, b: Surface) -> dict[str, Any]:
    """Return the arrays that `export_correspondence` writes, by name."""
    corners = file_vertices(b)[found.target_faces[found.faces]]
    corners[~found.matched] = -1
    return {
        "corners": at_file_vertices(a, corners, -1),
        "barycentric": at_file_vertices(a, np.nan_to_num(found.barycentric), 0.0),
        "confidence": at_file_vertices(a, found.confidence, 0.0),
        "residual": found.residual,
        "oriented": found.oriented,
        "ambiguous": found.ambiguous,
    }


def place_colours(surface: Surface) -> Floats:
    """Return a colour for each vertex, (n, 3): its place along each side of the bounding box, from 0 to 1."""
    used = surface.vertices[surface.used_vertices]
    low, sides = used.min(axis=0), np.ptp(used, axis=0)
    shares = (surface.vertices - low) / np.where(sides > 0, sides, 1.0)
    return np.asarray(np.clip(np.nan_to_num(shares, nan=0.5), 0.0, 1.0))


def _carried(found: Correspondence, colours: Floats) -> NDArray[np.float64]:
    carried = transfer(found, colours)
    return np.where(np.isfinite(carried), np.clip(carried, 0.0, 1.0), 0.5)
