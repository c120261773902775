"""Signatures and vectors as bytes: npz without pickle, and little-endian float64."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats
from unbend.local.signatures import STEPS, LocalSignatures
from unbend.signature.parameters import Parameters
from unbend.signature.signature import Signature

_ARRAYS = ("points", "faces", "samples", "weights")
_NUMBERS = ("scale", "stress", "asymmetry")
_LEVEL = 1
"""Compression level. The default level takes several times as long, and hardly reduces the size of coordinates."""


@dataclass(frozen=True)
class PackedSignature:
    """A signature in the form that the store has."""

    parameters: str
    version: str
    stress: float
    payload: bytes
    vectors: Mapping[str, bytes]
    """The descriptors, by name."""
    warnings: tuple[str, ...] = ()
    dimension: int | None = None
    boundary: float | None = None
    local: bytes | None = None
    """The local signatures; None if they were not computed."""

    @classmethod
    def of(cls, signature: Signature) -> Self:
        """Pack a signature."""
        vectors = {name: pack_vector(vector) for name, vector in signature.descriptors.items()}
        parameters = signature.parameters.to_json()
        payload = pack_signature(signature)
        local = pack_local(signature.local) if signature.local else None
        return cls(
            parameters, signature.version, signature.stress, payload, vectors, signature.warnings, signature.dimension,
            signature.boundary, local,
        )  # fmt: skip


def pack_signature(signature: Signature) -> bytes:
    """Return `signature` without its descriptors as an npz file: arrays, and the rest as JSON under "about"."""
    about = {name: getattr(signature, name) for name in _NUMBERS}
    about |= {"parameters": signature.parameters.as_dict(), "version": signature.version}
    about |= {"warnings": signature.warnings, "boundary": signature.boundary}
    return _archive({name: getattr(signature, name) for name in _ARRAYS}, about)


def pack_local(local: LocalSignatures) -> bytes:
    """Return local signatures as an npz file of about 60 kB.

    The file has only the distances above the diagonal. Each is rounded to a whole number of steps. The
    largest distance is 255 steps.
    """
    step = float(local.distances.max(initial=0.0)) / STEPS
    above = local.distances[np.triu_indices(len(local), 1)]
    arrays = {
        "places": local.places, "growth": local.growth, "reach": local.reach,
        "distances": np.rint(above / step).astype(np.uint8) if step > 0 else np.zeros(len(above), np.uint8),
    }  # fmt: skip
    return _archive(arrays, {"first": local.first, "area": local.area, "version": local.version, "step": step})


def unpack_local(payload: bytes) -> LocalSignatures:
    """Return the local signatures of a payload by `pack_local`."""
    with np.load(io.BytesIO(payload), allow_pickle=False) as file:
        about = json.loads(file["about"].tobytes())
        distances = np.zeros((len(file["places"]),) * 2, np.float32)
        distances[np.triu_indices(len(distances), 1)] = file["distances"] * np.float32(about.pop("step"))
        arrays = {name: file[name] for name in ("places", "growth", "reach")}
        return LocalSignatures(**arrays, distances=distances + distances.T, **about)


def _archive(arrays: Mapping[str, NDArray[Any]], about: Mapping[str, Any]) -> bytes:
    """Return an npz file of arrays, and of JSON under "about"."""
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as archive:
        for name, array in {**arrays, "about": text}.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, np.asarray(array), allow_pickle=False)
    return buffer.getvalue()


def unpack_signature(payload: bytes, vectors: Mapping[str, bytes]) -> Signature:
    """Return the signature of a payload by `pack_signature` and its descriptors by `pack_vector`."""
    with np.load(io.BytesIO(payload), allow_pickle=False) as file:
        about = json.loads(file["about"].tobytes())
        return Signature(
            **{name: file[name] for name in _ARRAYS},
            **{name: about[name] for name in _NUMBERS},
            descriptors={name: np.frombuffer(vector, "<f8") for name, vector in vectors.items()},
            parameters=Parameters.from_dict(about["parameters"]),
            version=about["version"],
            warnings=tuple(about.get("warnings", ())),  # payloads of earlier versions have none
            boundary=about.get("boundary"),
        )


def pack_vector(vector: Floats) -> bytes:
    """Return `vector` as little-endian float64."""
    return vector.astype("<f8").tobytes()
