"""Reading a mesh file: bytes or a path in, a checked `Surface` out."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import trimesh

from unbend.arrays import Floats, Indices
from unbend.errors import MeshError, MeshReadError
from unbend.mesh.formats.announced import announced
from unbend.mesh.formats.detect import detect_format
from unbend.mesh.formats.glb import read_glb
from unbend.mesh.formats.ply import read_ply
from unbend.mesh.formats.quick import QUICK
from unbend.mesh.formats.text import bare_obj, check_off, one_solid
from unbend.mesh.limits import UNLIMITED, MeshLimits
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.repair import repair
from unbend.mesh.rows import equal_points
from unbend.mesh.surface import Surface

_PREPARE: dict[str, Callable[[bytes], bytes]] = {"obj": bare_obj, "stl": one_solid}
_CHECK: dict[str, Callable[[bytes], None]] = {"off": check_off}


def read_mesh(
    source: bytes | str | Path | BinaryIO,
    *,
    file_type: str | None = None,
    policy: MeshPolicy | None = None,
    limits: MeshLimits | None = None,
    progress: Callable[[str], None] | None = None,
) -> Surface:
    """Read a mesh from a path, bytes or a binary file object.

    Parameters
    ----------
    source : bytes, str, Path or binary file
        Where the mesh is. The format is told by content; polygons are cut into triangles.
    file_type : str, optional
        "off", "obj", "ply", "stl" or "glb": used where the content does not tell. A path's own by default.
    policy : MeshPolicy, optional
        What to do with several components, noise, and more vertices than wanted; keeps the largest component and
        all vertices, where they are, by default.
    limits : MeshLimits, optional
        Most vertices and triangles that the file may hold, whatever the policy makes of them; any number by default.
    progress : callable, optional
        Called with the name of each stage as it begins: "reading", "repairing".

    Returns
    -------
    Surface
        Vertices in the order of the file, none welded; those of stl, which has no shared vertices, are merged
        where their coordinates are equal. Where the policy has the mesh simplified, `vertex_map` says where its
        vertices went. `report` says what was found and done.

    Raises
    ------
    MeshFormatError
        If it is none of the formats above.
    MeshReadError
        If the file is damaged; the message says where.
    MeshTooLargeError
        If it holds more than `limits` allow; as soon as its header says so, where it has one.
    MeshGeometryError
        If it holds no usable surface.
    OSError
        If a path cannot be read.
    """
    report = progress or (lambda _stage: None)
    report("reading")
    data, hint = _bytes_of(source)
    kind = detect_format(data, (file_type or hint).lower().lstrip("."))
    limits = limits or UNLIMITED
    limits.check(*announced(data, kind))
    vertices, faces = _parse(data, kind, limits)
    if kind == "stl":
        vertices, faces = _weld(vertices, faces)
    limits.check(len(vertices), len(faces))
    report("repairing")
    return repair(vertices, faces, file_type=kind, policy=policy)


def _bytes_of(source: bytes | str | Path | BinaryIO) -> tuple[bytes, str]:
    if isinstance(source, bytes):
        return source, ""
    if isinstance(source, str | Path):
        path = Path(source)
        return path.read_bytes(), path.suffix
    return source.read(), ""


def _parse(data: bytes, kind: str, limits: MeshLimits) -> tuple[Floats, Indices]:
    if kind in QUICK and (plain := QUICK[kind](data)):
        return plain
    if kind in _CHECK:
        _CHECK[kind](data)
    data = _PREPARE[kind](data) if kind in _PREPARE else data
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # NumPy's word for numbers cut short
            warnings.simplefilter("ignore", RuntimeWarning)
            if kind == "glb":
                return read_glb(data, limits)
            if kind == "ply":
                return read_ply(data)
            loaded = _load(data, kind)
    except MeshError:
        raise
    except MemoryError:
        raise
    except Exception as error:  # a damaged file fails in as many ways as there are damages
        raise MeshReadError(f"the {kind} file is damaged or incomplete") from error
    vertices = np.asarray(getattr(loaded, "vertices", np.empty((0, 3))), dtype=np.float64)
    faces = np.asarray(getattr(loaded, "faces", np.empty((0, 3))), dtype=np.int64)
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def _load(data: bytes, kind: str) -> Any:
    # Processing off: nothing is welded, dropped or reordered.
    scene = trimesh.load_scene(
        io.BytesIO(data),
        file_type=kind,
        process=False,
        maintain_order=True,
        skip_materials=True,
        fix_texture=False,
    )
    parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    if not parts:
        raise MeshReadError(f"the {kind} file holds no triangles")
    return parts[0] if len(parts) == 1 else trimesh.util.concatenate(parts)


def _weld(vertices: Floats, faces: Indices) -> tuple[Floats, Indices]:
    first = equal_points(vertices)
    kept = first == np.arange(len(vertices))  # the first of equal ones stands for all, so the file's order stays
    return vertices[kept], (np.cumsum(kept) - 1)[first][faces]
