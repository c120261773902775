"""Reading a mesh file: bytes or a path in, a checked `Surface` out."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from unbend.errors import MeshError, MeshReadError
from unbend.mesh.formats.detect import detect_format
from unbend.mesh.formats.parsed import ParsedMesh
from unbend.mesh.formats.registry import REGISTRY
from unbend.mesh.limits import UNLIMITED, MeshLimits
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.repair import repair
from unbend.mesh.rows import equal_points
from unbend.mesh.surface import Surface


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
        What to do with seams, several components, noise, and more vertices than wanted. By default seams are joined,
        and the largest component is kept.
    limits : MeshLimits, optional
        Most vertices and triangles that the file may hold, whatever the policy makes of them; any number by default.
    progress : callable, optional
        Called with the name of each stage as it begins: "reading", "repairing".

    Returns
    -------
    Surface
        Vertices are in the order of the file; in an stl file each facet has three of its own. Where copies of a vertex
        were joined at a seam, or the policy has the mesh simplified, `vertex_map` says where each vertex of the file
        went. `report` says what was found, done and skipped, and `report.warnings` what may make an answer wrong.

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
    limits.check(*REGISTRY[kind].announced(data))
    parsed = _parse(data, kind, limits)
    report("repairing")
    return repair(parsed.vertices, parsed.faces, file_type=kind, notes=parsed.notes, policy=policy)


def _bytes_of(source: bytes | str | Path | BinaryIO) -> tuple[bytes, str]:
    if isinstance(source, bytes):
        return source, ""
    if isinstance(source, str | Path):
        path = Path(source)
        return path.read_bytes(), path.suffix
    return source.read(), ""


def _parse(data: bytes, kind: str, limits: MeshLimits) -> ParsedMesh:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            parsed = REGISTRY[kind].read(data, limits)
    except (MeshError, MemoryError):
        raise
    except Exception as error:  # a damaged file fails in as many ways as there are damages
        raise MeshReadError(f"the {kind} file is damaged or incomplete") from error
    if not len(parsed.faces):
        raise MeshReadError(f"the {kind} file holds no triangles")
    limits.check(_places(parsed, kind, limits), len(parsed.faces))
    return parsed


def _places(parsed: ParsedMesh, kind: str, limits: MeshLimits) -> int:
    """Return how many vertices count: of stl, in which each facet has its own, as many as there are places."""
    number = len(parsed.vertices)
    if kind != "stl" or limits.vertices is None or number <= limits.vertices:
        return number
    return int((equal_points(parsed.vertices) == np.arange(number)).sum())
