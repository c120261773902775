"""The fields of an upload's multipart form, checked and converted."""

from __future__ import annotations

import asyncio
from mmap import ACCESS_READ, mmap
from pathlib import PurePosixPath
from typing import Any, Final, cast

from starlette.datastructures import UploadFile

from unbend.api.schema.problems import pointing_at
from unbend.errors import ParameterError
from unbend.jsons import parse_json
from unbend.library.metadata import MAX_METADATA_BYTES, check_metadata
from unbend.library.requests import Upload, UploadedFile
from unbend.mesh.formats.detect import detect_format
from unbend.mesh.policy import MeshPolicy
from unbend.names import MAX_TEXT
from unbend.signature.parameters import Parameters

_SMALL: Final = 2**20
"""Largest file that is always read into memory: the server does not spool it to disk."""

_MOST_TEXT: Final = 4 * MAX_METADATA_BYTES
"""Longest metadata text that is parsed. With escapes and spaces, it may be longer than `MAX_METADATA_BYTES`."""


async def read_upload(
    file: UploadFile, parameters: str | None, policy: str | None, *, in_memory: bool = True
) -> Upload:
    """Return the upload: the file, its format, parameters and policy.

    Unless `in_memory`, a file that the server spooled to disk is hashed there, and not read into memory.

    Raises
    ------
    MeshFormatError
        If the format is unknown. A worker parses the file later.
    ParameterError
        If the parameters or the policy are not JSON, or out of range.
    """
    with pointing_at("body.parameters"):
        chosen = Parameters.from_json(parameters) if parameters else Parameters()
    with pointing_at("body.policy"):
        reading = MeshPolicy.from_json(policy) if policy else MeshPolicy()
    hint = PurePosixPath(file.filename or "").suffix.lower().lstrip(".")
    if in_memory or (file.size or 0) <= _SMALL:
        data = await file.read()
        return Upload(data, detect_format(data, hint), chosen, reading)
    spooled = await asyncio.to_thread(UploadedFile.of, file.file)
    return Upload(spooled, await asyncio.to_thread(_detect, spooled, hint), chosen, reading)


def _detect(spooled: UploadedFile, hint: str) -> str:
    """Return the format of a file on disk. Detection looks at parts of a file, and a map has these as bytes."""
    mapped = mmap(spooled.file.fileno(), 0, access=ACCESS_READ)
    return detect_format(cast("bytes", mapped), hint)


def parse_metadata(text: str | None) -> dict[str, Any] | None:
    """Return the `metadata` field as an object, None if it is empty; ParameterError if it is not an object."""
    if not text:
        return None
    with pointing_at("body.metadata"):
        if len(text) > _MOST_TEXT:
            raise ParameterError(f"metadata has more than {_MOST_TEXT} characters")
        value = parse_json(text, "metadata")
        check_metadata(value)
    return dict(value)


def default_name(file: UploadFile) -> str:
    """Return the name of a file without folders and extension."""
    return PurePosixPath((file.filename or "").replace("\\", "/")).stem[:MAX_TEXT] or "unnamed"
