"""Shapes that are stored without computing them, for tests of the store."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from sqlalchemy import Connection

from unbend import Library, MeshPolicy, Parameters, Signature
from unbend.library import shapes as rows
from unbend.library.payload import PackedSignature
from unbend.library.records import ShapeRecord

PARAMETERS = Parameters(samples=40)


def signature(vector=(0.0, 0.0, 0.0)) -> Signature:
    """A signature of which only the moments matter."""
    points, faces = np.zeros((3, 3)), np.array([[0, 1, 2]])
    descriptors = {"moments": np.asarray(vector, float)}
    return Signature(points, faces, np.arange(3), np.full(3, 1 / 3), 1.0, 0.0, 0.0, descriptors, PARAMETERS)


def insert(connection: Connection, data: bytes, name: str, label=None, metadata=None, vector=(0, 0, 0)) -> ShapeRecord:
    """Store a shape whose file is `data`."""
    new = rows.NewShape(
        sha256=hashlib.sha256(data).hexdigest(), policy=MeshPolicy(), area=1.0,
        signature=PackedSignature.of(signature(vector)), report={"file_type": "off"},
        name=name, label=label, metadata=metadata or {},
    )  # fmt: skip
    rows.put_mesh(connection, new.sha256, data)
    return rows.get_shape(connection, rows.add_shape(connection, new))


def add(library: Library, data: bytes, name: str, label=None, metadata=None, vector=(0, 0, 0)) -> ShapeRecord:
    with library.store.write() as connection:
        return insert(connection, data, name, label, metadata, vector)


def in_files(path: Path) -> bytes:
    """Every byte that SQLite keeps of a database on disk."""
    found = [Path(f"{path}{ending}") for ending in ("", "-wal", "-shm", "-journal")]
    return b"".join(part.read_bytes() for part in found if part.exists())
