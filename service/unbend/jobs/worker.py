"""The functions that run in worker processes. A server parses uploaded files only in these functions."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, Final

import numpy as np

from unbend.arrays import Floats
from unbend.correspondence.export import export_correspondence
from unbend.correspondence.match import Turn, match
from unbend.correspondence.pieces import Part
from unbend.errors import JobMemoryError
from unbend.geodesics.distances import Update, geodesic_distances
from unbend.geodesics.paths.shortest import geodesic_path
from unbend.jobs.limits import limit_process
from unbend.jobs.reporting import ProgressReporter
from unbend.library import Library
from unbend.library.address import LibraryAddress
from unbend.library.requests import FileCall, FileRequest, UploadKey
from unbend.library.search import MapOptions
from unbend.library.shape_rows import ComputedShape
from unbend.library.storage.database import must_exist
from unbend.local.signatures import local_signatures
from unbend.matching.measures import MEASURES, compare
from unbend.matching.partial import profiles_of, search_parts
from unbend.mesh.correspondence import at_given_vertices, surface_vertex
from unbend.mesh.limits import MeshLimits
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh
from unbend.mesh.shapes import sheet, torus
from unbend.mesh.surface import Surface
from unbend.mesh.write import write_mesh
from unbend.progress import Progress
from unbend.render.display import MOST_FACES, display, simplified_form
from unbend.render.picture import render_picture
from unbend.render.request import PictureRequest
from unbend.signature.canonical_form import canonical_form
from unbend.signature.export import export_form
from unbend.signature.flattening import export_flattening, flatten
from unbend.signature.from_file import FileSignature, signature_of_file
from unbend.signature.parameters import Parameters
from unbend.signature.pipeline import compute_signature
from unbend.signature.signature import Signature

_TETRAHEDRON = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 {height}\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


@dataclass(frozen=True)
class StoredMesh:
    """A stored mesh file, and how to read it."""

    library: LibraryAddress
    sha256: str
    file_type: str
    """The format of the file, used if the content does not identify it."""
    policy: MeshPolicy
    limits: MeshLimits | None = None
    """Limits on the mesh; None for a file that was read within the limits before."""


@dataclass(frozen=True)
class ShapeOutcome:
    """The results of an upload, ready to store."""

    shape: ComputedShape
    seconds: Mapping[str, float]
    """Time of each stage."""


@dataclass(frozen=True)
class QueryOutcome:
    """The signature of a query."""

    signature: Signature
    seconds: Mapping[str, float]
    """Time of each stage."""


@dataclass(frozen=True)
class Geodesics:
    """Distances from a vertex of a file to every vertex, None if unreachable or removed, and a path to one vertex."""

    distances: list[float | None] | None
    path: list[list[float]] | None
    length: float | None = None
    """Length of the path."""


def initialise(memory_bytes: int | None, number: int = 0) -> None:
    """Load the common kernels, so that jobs do not wait for them, and limit the process; `number` is its place."""
    warm_up(number)  # at the priority of the server, which is not ready before
    limit_process(memory_bytes)


def compute_shape(mesh: StoredMesh, parameters: Parameters, local: bool = True) -> ShapeOutcome:
    """Read a stored mesh and compute its signature for the library, with or without local signatures.

    Raises
    ------
    MeshError
        If the mesh cannot be used.
    JobMemoryError
        If it needs more memory than allowed.
    """
    found, seconds = _compute(mesh, parameters, local=local)
    key = UploadKey.of(mesh.sha256, parameters, mesh.policy)
    return ShapeOutcome(ComputedShape.of(key, found), seconds)


def compute_query(mesh: StoredMesh, parameters: Parameters, local: bool = False) -> QueryOutcome:
    """Read a stored mesh and compute its signature for a query, with or without local signatures.

    Raises as `compute_shape` does.
    """
    found, seconds = _compute(mesh, parameters, local=local)
    return QueryOutcome(found.signature, seconds)


def _compute(mesh: StoredMesh, parameters: Parameters, *, local: bool) -> tuple[FileSignature, Mapping[str, float]]:
    with ProgressReporter() as reporter:
        try:
            found = signature_of_file(
                _file(mesh), parameters, mesh.policy, file_type=mesh.file_type, limits=mesh.limits,
                progress=reporter.report, threads=1, local=local,
            )  # fmt: skip
        except Exception as error:
            reporter.send()  # the client learns which stage failed
            if isinstance(error, MemoryError):
                raise JobMemoryError("the mesh needs more memory than a job may use") from None
            raise
    return found, reporter.seconds()


def geodesics_from(
    mesh: StoredMesh, update: Update, source: int, target: int | None = None, with_distances: bool = True
) -> Geodesics:
    """Return the geodesic distances of a stored mesh from one vertex of its file, and a path to another.

    Without `with_distances`, it computes only the path.

    Raises
    ------
    UnsuitedError
        If `source` or `target` is not a vertex of the file, simplification removed it, or no path joins them.
    """
    surface = _read(mesh)
    start = surface_vertex(surface, source, "source")
    found = None
    if with_distances:
        distances = _distances(surface, start, update)
        found = [float(distance) if np.isfinite(distance) else None for distance in distances]
    if target is None:
        return Geodesics(found, None)
    path = geodesic_path(surface, start, surface_vertex(surface, target, "target"))
    return Geodesics(found, path.tolist(), float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()))


def geodesic_floats(mesh: StoredMesh, update: Update, source: int) -> bytes:
    """Return the distances of `geodesics_from` as little-endian floats, NaN for unreachable vertices."""
    surface = _read(mesh)
    distances = _distances(surface, surface_vertex(surface, source, "source"), update)
    return np.where(np.isfinite(distances), distances, np.nan).astype("<f4").tobytes()


def viewer_file_of(
    data: bytes, file_type: str, parameters: Parameters, policy: MeshPolicy, limits: MeshLimits, most_faces: int
) -> bytes:
    """Return the mesh of a file that is not in the library, and its signature, as one glb file for viewers.

    Raises
    ------
    MeshError
        If the mesh cannot be used.
    """
    found = signature_of_file(data, parameters, policy, file_type=file_type, limits=limits, threads=1)
    return display(found.surface, found.signature, most_faces).as_glb()


def _distances(surface: Surface, start: int, update: Update) -> Floats:
    return at_given_vertices(surface, geodesic_distances(surface, start, update=update, threads=1)[0])


def draw_picture(mesh: StoredMesh, signature: Signature | None, request: PictureRequest) -> bytes:
    """Return a picture of a stored mesh, and of its signature if one is given."""
    surface, form = _read(mesh), None
    if signature is not None:
        surface, form, _ = simplified_form(surface, signature, MOST_FACES)
    return render_picture(request, surface, form, threads=1)


def viewer_file(mesh: StoredMesh, signature: Signature, most_faces: int) -> bytes:
    """Return a stored mesh and its signature as one glb file for viewers."""
    return display(_read(mesh), signature, most_faces).as_glb()


def convert(mesh: StoredMesh, file_type: str) -> bytes:
    """Return a stored mesh, after reading and repair, in another format."""
    surface = _read(mesh)
    return write_mesh(surface.vertices, surface.faces, file_type)


def canonical_form_file(mesh: StoredMesh, signature: Signature, file_type: str) -> bytes:
    """Return the canonical form of a stored mesh at full resolution, as a file."""
    return export_form(canonical_form(_read(mesh), signature=signature, threads=1), file_type)


def flattened(mesh: StoredMesh, parameters: Parameters, file_type: str) -> bytes:
    """Return a stored mesh with the texture coordinates of its flattening, as a file."""
    return export_flattening(flatten(_read(mesh), parameters, threads=1), file_type)


def make_file(mesh: StoredMesh, request: FileRequest) -> bytes:
    """Make the file of a job from a stored mesh."""
    with ProgressReporter() as reporter:
        reporter.report(Progress("reading"))
        reporter.send()
        return _FILE_CALLS[request.call](mesh, **request.arguments)


def _geodesics_file(mesh: StoredMesh, update: Update, source: int, target: int | None) -> bytes:
    found = geodesics_from(mesh, update, source, target)
    return json.dumps({"source": source, "target": target, **vars(found)}).encode()


def _flattening_file(mesh: StoredMesh, parameters: dict[str, Any], file_type: str) -> bytes:
    return flattened(mesh, Parameters.from_dict(parameters), file_type)


def _form_file(mesh: StoredMesh, shape_id: str, file_type: str) -> bytes:
    return canonical_form_file(mesh, _library(mesh.library).shapes.signature(shape_id), file_type)


def _match_file(
    mesh: StoredMesh, other_id: str, orientation: Turn, samples: int, file_type: str, part: Part = "auto"
) -> bytes:
    other = _library(mesh.library).shapes.get(other_id)
    target = _read(StoredMesh(mesh.library, other.sha256, other.file_type, other.policy))
    surface = _read(mesh)
    found = match(surface, target, samples=samples, orientation=orientation, part=part, threads=1)
    return export_correspondence(found, surface, target, file_type)


_FILE_CALLS: Final[Mapping[FileCall, Callable[..., bytes]]] = {
    "mesh": convert,
    "signature": _form_file,
    "flattening": _flattening_file,
    "geodesics": _geodesics_file,
    "match": _match_file,
}


def library_map(
    library: LibraryAddress, measure: str, parameters: Parameters | None, options: MapOptions
) -> dict[str, Any]:
    """Return `Library.map` as JSON values."""
    return _library(library).map(measure, parameters=parameters, **asdict(options)).as_dict()


def library_evaluation(library: LibraryAddress, measure: str, parameters: Parameters | None) -> dict[str, Any]:
    """Return `Library.evaluation` as JSON values."""
    return _library(library).evaluation(measure, parameters=parameters).as_dict()


def warm_up(first: int = 0) -> None:
    """Compile or load the common kernels, with small meshes; do nothing if this process, or its fork server, has.

    Parameters
    ----------
    first : int
        The first part of the work, counted in a circle. Processes that begin with different parts, and then do the
        others, do not compile the same kernels at the same time: each loads what another has compiled.
    """
    parts = (_warm_up_signatures, _warm_up_parts, _warm_up_paths)
    for number in range(len(parts)):
        parts[(first + number) % len(parts)]()


@cache
def _warm_up_signatures() -> None:
    """Signatures, measures and pictures."""
    surfaces = _tetrahedra()
    first, second = (compute_signature(surface, threads=1) for surface in surfaces)
    for measure in MEASURES:
        compare(first, second, measure)
    surface, form, _ = simplified_form(surfaces[0], first, MOST_FACES)
    request = PictureRequest(width=32, height=32, subject="both", distances_from=0, contours=True, path=(0, 1))
    render_picture(request, surface, form, threads=1)
    thin, ring = sheet(columns=9, rows=7), torus(minor=0.4, columns=14, rows=8)
    for vertices, faces in ((thin.vertices * [1.0, 0.02, 1.0], thin.faces), (ring.vertices, ring.faces)):
        compute_signature(read_mesh((vertices, faces)), threads=1)  # narrow triangles, and obtuse ones


@cache
def _warm_up_parts() -> None:
    parts = [local_signatures(surface, centres=8, threads=1) for surface in _tetrahedra()]
    search_parts(parts[0], [profiles_of(parts[1])], lambda _rows: parts[1:])


@cache
def _warm_up_paths() -> None:
    geodesic_path(_tetrahedra()[0], 0, 1)


def _tetrahedra() -> list[Surface]:
    return [read_mesh(_TETRAHEDRON.format(height=height).encode()) for height in (1, 2)]


def _read(mesh: StoredMesh) -> Surface:
    return read_mesh(_file(mesh), file_type=mesh.file_type, policy=mesh.policy, limits=mesh.limits)


def _file(mesh: StoredMesh) -> bytes:
    return _library(mesh.library).shapes.file(mesh.sha256)


@cache
def _library(address: LibraryAddress) -> Library:
    must_exist(address.url)
    return Library(address.url, migrate=False, objects=address.objects)
