"""From a multipart form to an `Upload` that the job runner takes."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any, Final

from starlette.datastructures import UploadFile

from unbend.api.problems import pointing_at
from unbend.errors import ParameterError
from unbend.jobs import Upload
from unbend.jsons import parse_json
from unbend.library.values import MAX_METADATA_BYTES, check_metadata
from unbend.mesh.formats.detect import detect_format
from unbend.mesh.policy import MeshPolicy
from unbend.names import MAX_TEXT
from unbend.signature.parameters import Parameters

_MOST_TEXT: Final = 4 * MAX_METADATA_BYTES
"""Characters that are parsed: JSON may write a byte as six, and spaces between."""


async def read_upload(file: UploadFile, parameters: str | None, policy: str | None) -> Upload:
    """Return the file's bytes, its format, and what to compute of it.

    Raises
    ------
    MeshFormatError
        If the bytes are of no format that is read. Nothing is parsed here.
    ParameterError
        If the parameters or the policy are not JSON or out of range.
    """
    with pointing_at("body.parameters"):
        chosen = Parameters.from_json(parameters) if parameters else Parameters()
    with pointing_at("body.policy"):
        reading = MeshPolicy.from_json(policy) if policy else MeshPolicy()
    data = await file.read()
    hint = PurePosixPath(file.filename or "").suffix.lower().lstrip(".")
    file_type = detect_format(data, hint)
    return Upload(data, file_type, chosen, reading)


def parse_metadata(text: str | None) -> dict[str, Any]:
    """Return the `metadata` field as an object; ParameterError if it is not one."""
    with pointing_at("body.metadata"):
        if text and len(text) > _MOST_TEXT:
            raise ParameterError(f"metadata has more than {_MOST_TEXT} characters")
        value = parse_json(text, "metadata") if text else {}
        check_metadata(value)
    return dict(value)


def name_of(file: UploadFile, name: str | None) -> str:
    """Return the name given, or the file's own without folders and extension."""
    return name or PurePosixPath((file.filename or "").replace("\\", "/")).stem[:MAX_TEXT] or "unnamed"
