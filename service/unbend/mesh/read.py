"""Reading of mesh files: from bytes or a path to a checked `Surface`."""

from __future__ import annotations

import warnings

import numpy as np

from unbend.errors import MeshError, MeshReadError
from unbend.mesh.formats.detect import detect_format
from unbend.mesh.formats.parsed import ParsedMesh
from unbend.mesh.formats.registry import REGISTRY
from unbend.mesh.limits import UNLIMITED, MeshLimits
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.repair import repair
from unbend.mesh.rows import equal_points
from unbend.mesh.sources import MeshSource, arrays_of, bytes_of
from unbend.mesh.surface import Surface
from unbend.progress import Progress, ProgressCallback, ignore


def read_mesh(
    source: MeshSource,
    *,
    file_type: str | None = None,
    policy: MeshPolicy | None = None,
    limits: MeshLimits | None = None,
    progress: ProgressCallback | None = None,
) -> Surface:
    """Read a mesh from a file, or take one from memory, and check and repair it.

    Parameters
    ----------
    source : bytes, str, Path, binary file, Surface, pair of arrays, or mesh object
        The mesh. The content of a file determines its format; polygons are cut into triangles. A pair of arrays has
        vertices (n, 3) and faces (m, 3). Mesh objects of trimesh, Open3D and meshio are taken as they are.
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
    ParameterError
        If `source` is none of these.
    MeshFileError
        If a file cannot be opened; MeshMissingError if there is none.

    Examples
    --------
    >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> read_mesh((square, [[0, 1, 2], [0, 2, 3]])).area
    1.0
    """
    report = progress or ignore
    limits = limits or UNLIMITED
    report(Progress("reading"))
    if (given := arrays_of(source)) is not None:
        limits.check(len(given.vertices), len(given.faces))
        report(Progress("repairing"))
        return repair(given.vertices, given.faces, policy=policy)
    file = bytes_of(source)
    data = file.data
    kind = detect_format(data, (file_type or file.file_type).lower().lstrip("."))
    limits.check(*REGISTRY[kind].announced(data))
    parsed = _parse(data, kind, limits)
    report(Progress("repairing"))
    return repair(parsed.vertices, parsed.faces, file_type=kind, notes=parsed.notes, policy=policy)


def surface_of(source: MeshSource, *, progress: ProgressCallback | None = None) -> Surface:
    """Return `source` if it is a `Surface`; read it by `read_mesh` with the default policy if it is anything else."""
    return source if isinstance(source, Surface) else read_mesh(source, progress=progress)


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
