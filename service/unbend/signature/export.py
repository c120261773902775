"""Export of signatures and canonical forms: mesh files for viewers, JSON and NPZ for programs."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.mesh.write import check_format, write_mesh
from unbend.signature.canonical_form import CanonicalForm, in_space
from unbend.signature.signature import Signature

_ABOUT = ("asymmetry", "parameters", "version", "warnings", "boundary")  # fields that are no arrays
_SPACE = 3  # dimensions that become coordinates; the next three become colours


def export_signature(signature: Signature, file_type: str) -> bytes:
    """Return `signature` as bytes.

    Parameters
    ----------
    signature : Signature
    file_type : str
        "ply", "obj", "off" or "glb": the signature surface in its first three dimensions. Missing dimensions are zero.
        The fourth to sixth dimension, if any, become colours of the vertices (`coordinate_colours`).
        "json" or "npz": all fields except the local signatures. In npz, descriptors are arrays by their own names, and
        "about" has the fields that are no arrays, as bytes of JSON.

    Raises
    ------
    ParameterError
        If the format is none of these.
    """
    if file_type == "json":
        return json.dumps(signature_as_dict(signature)).encode()
    if file_type == "npz":
        names = ("points", "faces", "samples", "weights", "scale", "stress")
        about = {name: value for name, value in signature_as_dict(signature).items() if name in _ABOUT}
        arrays = {name: getattr(signature, name) for name in names} | signature.descriptors
        return _npz(arrays | {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)})
    return _mesh_file(signature.points, signature.faces, file_type)


def export_form(form: CanonicalForm, file_type: str) -> bytes:
    """Return a canonical form as bytes.

    Parameters
    ----------
    form : CanonicalForm
    file_type : str
        "ply", "obj", "off" or "glb": coordinates and colours as in `export_signature`.
        "json" or "npz": points, faces, samples, scale and stress. Points are null or NaN at vertices that no face uses.

    Raises
    ------
    ParameterError
        If the format is none of these.
    """
    signature = form.signature
    if file_type == "json":
        unused = np.isnan(form.points[:, 0]).tolist()
        members = {
            "points": [None if missing else point for point, missing in zip(form.points.tolist(), unused, strict=True)],
            "faces": form.faces.tolist(),
            "samples": signature.samples.tolist(),
            "scale": signature.scale,
            "stress": signature.stress,
        }
        return json.dumps(members).encode()
    if file_type == "npz":
        arrays = {"points": form.points, "faces": form.faces, "samples": signature.samples}
        return _npz(arrays | {"scale": signature.scale, "stress": signature.stress})
    return _mesh_file(form.points, form.faces, file_type)


def coordinate_colours(points: Floats) -> Floats | None:
    """Return the fourth to sixth coordinate of each point as red, green and blue, or None below four dimensions.

    The colour of coordinate x is c = 0.5 + (x - middle) / range, where `middle` is the mean of the coordinate's least
    and largest value, and `range` is the widest range of the three coordinates. So equal steps of colour are equal
    lengths in all three coordinates, and x = middle + range (c - 0.5). The colour is 0.5 for a coordinate that is
    missing or not finite. Files with 8 bits per colour have an error of up to range / 510.

    Parameters
    ----------
    points : (n, m) float64

    Returns
    -------
    (n, 3) float64 or None
        Values from 0 to 1.
    """
    shown = points[:, _SPACE : 2 * _SPACE]
    if shown.shape[1] == 0:
        return None
    least, largest = np.nanmin(shown, axis=0), np.nanmax(shown, axis=0)
    widest = (largest - least).max() or 1.0
    colours = np.full((len(points), _SPACE), 0.5)
    colours[:, : shown.shape[1]] += np.nan_to_num((shown - (least + largest) / 2) / widest)
    return np.asarray(np.clip(colours, 0.0, 1.0))


def signature_as_dict(signature: Signature) -> dict[str, object]:
    """Return a signature as plain JSON values, without its fields `boundary` and `local`."""
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
        "warnings": list(signature.warnings),
        "boundary": signature.boundary,
    }


def _mesh_file(points: Floats, faces: Ints, file_type: str) -> bytes:
    check_format(file_type)
    return write_mesh(in_space(points), faces, file_type, colours=coordinate_colours(points))


def _npz(arrays: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()
