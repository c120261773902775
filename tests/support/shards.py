"""Shards of small meshes, and shards whose entries somebody has changed and signed again."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from unbend.errors import ResultsError
from unbend.library.computed import compute_file
from unbend.library.packing import unpack_signature
from unbend.library.requests import UploadKey
from unbend.library.shape_rows import ComputedShape
from unbend.library.shards.entries import Entry, encode, read_entries, read_part
from unbend.library.shards.index import ShardIndex
from unbend.library.shards.numbering import ShardNumber
from unbend.library.shards.records import FILE, SHAPE, FileRecord, encode_shape, read_mesh_of, read_shape
from unbend.library.shards.writer import ShardWriter

QUICK = {"samples": 8, "method": "classical"}

WHOLE = ShardNumber()

Change = Callable[[dict[str, Any], dict[str, bytes]], None]
"""A change of the JSON and of the parts of an entry."""


def entries_of(mesh: bytes, path: str, *, parts: bool = False) -> tuple[list[bytes], list[bytes]]:
    """Return the two entries of a mesh: its results, and its file."""
    computed = compute_file(mesh, QUICK, parts=parts)
    return encode_shape(computed, mesh), FileRecord(path, computed.key, "in", written=1.0).encode()


def write_shard(folder: Path, entries: Iterable[list[bytes]], shard: ShardNumber = WHOLE) -> Path:
    """Write a finished shard, and return its path."""
    with ShardWriter(folder, shard, {}) as writer:
        for entry in entries:
            writer.append(entry)
    return max(folder.glob("*.shard"))


def forged(source: Path, target: Path, change: Change, kind: str = SHAPE) -> Path:
    """Write a copy of a shard in which the first entry of a kind is changed, with right checksums."""
    entries, is_changed = [], False
    for entry in read_entries(source):
        content = {name: value for name, value in entry.content.items() if name not in {"kind", "parts"}}
        parts = {name: read_part(entry, name) for name in entry.parts}
        if entry.kind == kind and not is_changed:
            change(content, parts)
            is_changed = True
        entries.append(encode(content.pop("kind", str(entry.kind)), content, parts))
    assert is_changed
    return write_shard(target, entries)


def edited(payload: bytes, about: dict[str, Any] | None = None, **arrays: Any) -> bytes:
    """Return an npz payload with some arrays, and some values of its JSON, replaced; None removes an array."""
    with np.load(io.BytesIO(payload)) as file:
        members = {name: file[name] for name in file.files}
    values = json.loads(members["about"].tobytes()) | (about or {})
    members["about"] = np.frombuffer(json.dumps(values).encode(), np.uint8)
    members = {name: value for name, value in (members | arrays).items() if value is not None}
    buffer = io.BytesIO()
    np.savez(buffer, **members)
    return buffer.getvalue()


def contents(computed: ComputedShape) -> tuple[Any, ...]:
    """Return results in a form that can be compared: archives contain the time of packing."""
    packed = computed.signature
    found = unpack_signature(packed.payload, packed.vectors)
    arrays = (found.points, found.faces, found.samples, found.weights)
    return (
        computed.key, computed.area, json.dumps(computed.report), packed.stress, packed.dimension, packed.boundary,
        packed.warnings, *(array.tobytes() for array in arrays), tuple(sorted(packed.vectors.items())),
    )  # fmt: skip


def accepted(paths: Iterable[Path]) -> tuple[dict[UploadKey, tuple[Any, ...]], set[str], list[ResultsError]]:
    """Return the results and the files that are accepted of shards, and the errors."""
    shapes: dict[UploadKey, tuple[Any, ...]] = {}
    files: set[str] = set()
    errors: list[ResultsError] = []
    for path in paths:
        try:
            for entry in read_entries(path):
                _accept(entry, shapes, files, errors)
        except ResultsError as error:
            errors.append(error)
    return shapes, files, errors


def _accept(
    entry: Entry, shapes: dict[UploadKey, tuple[Any, ...]], files: set[str], errors: list[ResultsError]
) -> None:
    try:
        with ShardIndex() as index:
            index.add(entry)
        if entry.kind == FILE:
            files.add(json.dumps(FileRecord.of(entry).as_dict()))
        else:
            computed = read_shape(entry)
            shapes[computed.key] = (*contents(computed), read_mesh_of(entry))
    except ResultsError as error:
        errors.append(error)
