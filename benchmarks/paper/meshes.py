"""The shapes that stand in for the paper's, which were never published."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from benchmarks.common import DATA
from unbend import Surface, geodesic_distances, read_mesh
from unbend.mesh.shapes import figure, s_bend

Array = np.ndarray

STAND_INS = {"Torus": "torus.obj", "Human": "human_man.obj", "Rabbit": "bunny.obj", "Elephant": "elephant.obj"}


def single(name: str) -> Surface:
    """Return one of the single models, rotated so that z is up."""
    surface = read_mesh(DATA / "single" / name)
    return Surface(surface.vertices[:, [2, 0, 1]], surface.faces)


def camel_face() -> Surface:
    """Return the face of the camel's head: the part within a geodesic distance of a point between its eyes."""
    head = single("camelhead.off")
    low, high = head.vertices.min(axis=0), head.vertices.max(axis=0)
    muzzle = head.vertices[head.vertices[:, 0].argmax()]
    brow = np.array([high[0] - 0.35 * (high - low)[0], muzzle[1], high[2] - 0.3 * (high - low)[2]])
    middle = int(np.linalg.norm(head.vertices - brow, axis=1).argmin())
    return _cut(head, geodesic_distances(head, [middle])[0], 0.36 * (high - low).max())


def curtain() -> Surface:
    """Return a sheet bent like an S."""
    return s_bend(1.1 * math.pi, width=2.0, height=1.0, columns=60, rows=30)


def hands() -> tuple[Surface, Surface]:
    return figure("hand", 0, resolution=6000), figure("hand", 4, resolution=6000)


def _cut(surface: Surface, field: Array, level: float) -> Surface:
    """Return the part where `field` is below `level`; vertices beyond `level` move along their edges to it."""
    faces = surface.faces[(field[surface.faces] < level).any(axis=1)]
    points = surface.vertices.copy()
    for start, end in faces[:, [0, 1, 1, 2, 2, 0, 1, 0, 2, 1, 0, 2]].reshape(-1, 2):
        if field[start] < level <= field[end]:
            share = (level - field[start]) / (field[end] - field[start])
            points[end] = surface.vertices[start] + share * (surface.vertices[end] - surface.vertices[start])
    used, corners = np.unique(faces, return_inverse=True)
    return Surface(points[used], corners.reshape(-1, 3).astype(np.int32))


def listed(dataset: str, label: str) -> list[Path]:
    """Return the files of one class of a data set."""
    with (DATA / "labels.csv").open(newline="") as file:
        return [
            DATA / row["path"] for row in csv.DictReader(file) if (row["dataset"], row["class"]) == (dataset, label)
        ]
