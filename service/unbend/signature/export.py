"""A signature as a file: its surface for viewers, or everything for programs."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np

from unbend.arrays import Floats
from unbend.mesh.write import write_mesh
from unbend.signature.signature import Signature


def export_signature(signature: Signature, file_type: str) -> bytes:
    """Return `signature` as bytes.

    Parameters
    ----------
    signature : Signature
    file_type : str
        "ply", "obj", "off" or "glb": the signature surface, by its first three dimensions, a missing one zero.
        "json" or "npz": points, faces, samples, weights, descriptors and the numbers beside them.

    Raises
    ------
    ParameterError
        If the format is none of those.
    """
    if file_type == "json":
        return json.dumps(signature_as_dict(signature)).encode()
    if file_type == "npz":
        buffer = io.BytesIO()
        names = ("points", "faces", "samples", "weights", "scale", "stress")
        arrays: dict[str, Any] = {name: getattr(signature, name) for name in names} | signature.descriptors
        np.savez_compressed(buffer, **arrays)
        return buffer.getvalue()
    return write_mesh(_in_space(signature.points), signature.faces, file_type)


def signature_as_dict(signature: Signature) -> dict[str, object]:
    """Return all of a signature as plain JSON values."""
    return {
        "points": signature.points.tolist(),
        "faces": signature.faces.tolist(),
        "samples": signature.samples.tolist(),
        "weights": signature.weights.tolist(),
        "scale": signature.scale,
        "stress": signature.stress,
        "asymmetry": signature.asymmetry,
        "descriptors": {name: vector.tolist() for name, vector in signature.descriptors.items()},
        "parameters": signature.parameters.as_dict(),
        "version": signature.version,
    }


def _in_space(points: Floats) -> Floats:
    space = np.zeros((len(points), 3))
    shown = min(3, points.shape[1])
    space[:, :shown] = points[:, :shown]
    return space
