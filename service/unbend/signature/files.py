"""Files of signatures: save one, and load it again."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np

from unbend.errors import ParameterError, check_choice
from unbend.signature.export import export_signature
from unbend.signature.parameters import Parameters
from unbend.signature.signature import Signature

_Format = Literal["json", "npz"]
_ARRAYS: Final = ("points", "faces", "samples", "weights")
_NUMBERS: Final = ("scale", "stress", "asymmetry")


def save_signature(signature: Signature, path: str | PathLike[str]) -> None:
    """Write a signature to a file that `load_signature` reads.

    Parameters
    ----------
    signature : Signature
    path : str or path
        Ends with ".npz" (compact) or ".json" (text, about four times as large). Both keep all digits. Local signatures
        are not written.

    Raises
    ------
    ParameterError
        If the file name has another ending.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from unbend.mesh.shapes import sphere
    >>> from unbend.signature.pipeline import compute_signature
    >>> signature = compute_signature(sphere(), {"samples": 50})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_signature(signature, f"{folder}/ball.npz")
    ...     load_signature(f"{folder}/ball.npz").parameters.samples
    50
    """
    file_type = Path(path).suffix.lower().lstrip(".")
    check_choice("the format of a signature file", file_type, get_args(_Format))
    Path(path).write_bytes(export_signature(signature, file_type))


def load_signature(source: bytes | str | PathLike[str]) -> Signature:
    """Read a signature from a file by `save_signature`, `unbend signature` or the HTTP service.

    Parameters
    ----------
    source : bytes, str or path
        The content of a file or its path. The content determines whether it is npz or json.

    Raises
    ------
    ParameterError
        If the file is damaged, or no signature with all its fields.
    OSError
        If the file cannot be read.
    """
    data = source if isinstance(source, bytes) else Path(source).read_bytes()
    name = "the file" if isinstance(source, bytes) else str(source)
    try:
        return signature_from_dict(_members_of_npz(data) if zipfile.is_zipfile(io.BytesIO(data)) else json.loads(data))
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise ParameterError(f"{name} is no signature file: it is neither npz nor JSON") from None
    except (KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise ParameterError(f"{name} is no signature, or it is damaged: {error}") from error


def signature_from_dict(values: Mapping[str, Any]) -> Signature:
    """Return the signature of the members that `signature_as_dict` made; KeyError if one is missing."""
    members: dict[str, Any] = {name: np.asarray(values[name]) for name in _ARRAYS}
    members |= {name: float(values[name]) for name in _NUMBERS}
    return Signature(
        **members,
        descriptors={name: np.asarray(vector, np.float64) for name, vector in values["descriptors"].items()},
        parameters=Parameters.from_dict(values["parameters"]),
        version=str(values["version"]),
        warnings=tuple(values["warnings"]),
        boundary=values.get("boundary"),  # files of earlier versions have none
    )


def _members_of_npz(data: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        members = {name: file[name] for name in file.files}
    about: dict[str, Any] = json.loads(members.pop("about").tobytes())
    kept = {name: members.pop(name) for name in (*_ARRAYS, "scale", "stress")}
    return about | kept | {"descriptors": members}
