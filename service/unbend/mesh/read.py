"""Reading of mesh files: from bytes or a path to a checked `Surface`."""

from __future__ import annotations

import warnings
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
from unbend.progress import Progress, ProgressCallback, ignore


def read_mesh(
    source: bytes | str | Path | BinaryIO,
    *,
    file_type: str | None = None,
    policy: MeshPolicy | None = None,
    limits: MeshLimits | None = None,
    progress: ProgressCallback | None = None,
) -> Surface:
    """Read a mesh from a path, bytes or a binary file object.

    Parameters
    ----------
    source : bytes, str, Path or binary file
        The mesh. Its content determines the format; polygons are cut into triangles.
    file_type : str, optional
        "off", "obj", "ply", "stl" or "glb", for content that does not determine the format. The default is the
        extension of the path.
    policy : MeshPolicy, optional
        Treatment of seams, several components, noise, and too many vertices. By default seams are joined, and the
        largest component is kept.
    limits : MeshLimits, optional
        Most vertices and triangles of the file, before the policy is applied. There is no limit by default.
    progress : callable, optional
        Called with a `Progress` as each stage begins: "reading", "repairing".

    Returns
    -------
    Surface
        Vertices are in the order of the file; in an stl file each facet has its own three. If seams were joined or the
        mesh was simplified, `vertex_map` maps the vertices of the file to those of the surface. `report` lists findings
        and repairs, and `report.warnings` the reasons why results may be wrong.

    Raises
    ------
    MeshFormatError
        If the format is none of these.
    MeshReadError
        If the file is damaged. The message says where, if that is known.
    MeshTooLargeError
        If the file exceeds `limits`. Announced numbers are checked before the file is parsed.
    MeshGeometryError
        If the mesh has no usable surface, or the policy does not allow it.
    OSError
        If a path cannot be read.
    """
    report = progress or ignore
    report(Progress("reading"))
    data, hint = _bytes_of(source)
    kind = detect_format(data, (file_type or hint).lower().lstrip("."))
    limits = limits or UNLIMITED
    limits.check(*REGISTRY[kind].announced(data))
    parsed = _parse(data, kind, limits)
    report(Progress("repairing"))
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
    except Exception as error:  # damaged files cause all kinds of exceptions
        raise MeshReadError(f"the {kind} file is damaged or incomplete") from error
    if not len(parsed.faces):
        raise MeshReadError(f"the {kind} file contains no triangles")
    limits.check(_places(parsed, kind, limits), len(parsed.faces))
    return parsed


def _places(parsed: ParsedMesh, kind: str, limits: MeshLimits) -> int:
    """Return the number of vertices to compare with the limit; in stl, where facets share none, of different points."""
    number = len(parsed.vertices)
    if kind != "stl" or limits.vertices is None or number <= limits.vertices:
        return number
    return int((equal_points(parsed.vertices) == np.arange(number)).sum())
