"""Signatures and vectors as bytes: npz without pickle, and little-endian float64."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from unbend.arrays import Floats
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

    @classmethod
    def of(cls, signature: Signature) -> Self:
        """Pack a signature."""
        vectors = {name: pack_vector(vector) for name, vector in signature.descriptors.items()}
        parameters = signature.parameters.to_json()
        payload = pack_signature(signature)
        return cls(
            parameters, signature.version, signature.stress, payload, vectors, signature.warnings, signature.dimension
        )


def pack_signature(signature: Signature) -> bytes:
    """Return `signature` without its descriptors as an npz file: arrays, and the rest as JSON under "about"."""
    about = {name: getattr(signature, name) for name in _NUMBERS}
    about |= {"parameters": signature.parameters.as_dict(), "version": signature.version}
    about["warnings"] = signature.warnings
    arrays = {name: getattr(signature, name) for name in _ARRAYS}
    arrays["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as archive:
        for name, array in arrays.items():
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
        )


def pack_vector(vector: Floats) -> bytes:
    """Return `vector` as little-endian float64."""
    return vector.astype("<f8").tobytes()
