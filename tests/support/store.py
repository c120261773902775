"""Shapes stored without computing signatures, for tests of the store."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sqlalchemy import Connection

from unbend import Library, Parameters, Signature
from unbend.library import shape_rows
from unbend.library.packing import PackedSignature
from unbend.library.requests import ShapeRequest, Upload
from unbend.library.shape_rows import ComputedShape
from unbend.results.shapes import ShapeRecord

PARAMETERS = Parameters(samples=40)


def signature(vector=(0.0, 0.0, 0.0)) -> Signature:
    """Return a signature in which only the moments matter."""
    points, faces = np.zeros((3, 3)), np.array([[0, 1, 2]])
    descriptors = {"moments": np.asarray(vector, float)}
    return Signature(points, faces, np.arange(3), np.full(3, 1 / 3), 1.0, 0.0, 0.0, descriptors, PARAMETERS)


def insert(connection: Connection, data: bytes, name: str, label=None, metadata=None, vector=(0, 0, 0)) -> ShapeRecord:
    """Store a shape whose file is `data`."""
    key = Upload(data, "off", PARAMETERS).key
    shape_rows.put_mesh(connection, key.sha256, data)
    computed = ComputedShape(key, PackedSignature.of(signature(vector)), area=1.0, report={"file_type": "off"})
    return shape_rows.add_shape(connection, computed, ShapeRequest(name, label, metadata or {}))


def add(library: Library, data: bytes, name: str, label=None, metadata=None, vector=(0, 0, 0)) -> ShapeRecord:
    return library.store.change(lambda connection: insert(connection, data, name, label, metadata, vector))


def in_files(path: Path) -> bytes:
    """Return all bytes of the files of a SQLite database."""
    found = [Path(f"{path}{ending}") for ending in ("", "-wal", "-shm", "-journal")]
    return b"".join(part.read_bytes() for part in found if part.exists())
