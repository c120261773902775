"""What runs inside a worker process: the only place where an uploaded file is parsed."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, Final

import numpy as np

from unbend.errors import JobMemoryError
from unbend.geodesics.distances import Update, geodesic_distances
from unbend.geodesics.paths.shortest import geodesic_path
from unbend.jobs.limits import limit_process
from unbend.jobs.progress import StageClock
from unbend.library import Library
from unbend.library.engine import must_be_there
from unbend.library.overview import Shown
from unbend.library.payload import PackedSignature
from unbend.library.shapes import get_mesh
from unbend.matching.measures import MEASURES, compare
from unbend.mesh.correspondence import at_given_vertices, surface_vertex
from unbend.mesh.limits import MeshLimits
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh
from unbend.mesh.surface import Surface
from unbend.mesh.write import write_mesh
from unbend.signature.canonical_form import canonical_form
from unbend.signature.export import export_form
from unbend.signature.flattening import export_flattening, flatten
from unbend.signature.parameters import Parameters
from unbend.signature.pipeline import compute_signature
from unbend.signature.signature import Signature

_TETRAHEDRON = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 {height}\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


@dataclass(frozen=True)
class StoredMesh:
    """Where a mesh file is, its format where the content does not tell, and how it is read.

    One that was read once already needs no limits.
    """

    store_url: str
    sha256: str
    file_type: str
    policy: MeshPolicy
    limits: MeshLimits | None = None


@dataclass(frozen=True)
class Task:
    """A job, as much as a worker needs of it."""

    mesh: StoredMesh
    parameters: str


@dataclass(frozen=True)
class Outcome:
    """What a worker computed."""

    signature: PackedSignature
    area: float
    report: dict[str, Any]
    seconds: dict[str, float]
    """That each stage took."""


@dataclass(frozen=True)
class Geodesics:
    """Distances from a vertex of a file to all of them, None where it cannot reach, and the path to one of them."""

    distances: list[float | None]
    path: list[list[float]] | None


def initialise(memory_bytes: int | None) -> None:
    """Prepare a process that computes jobs: nobody's first job is to wait for kernels to be compiled or loaded."""
    limit_process(memory_bytes)
    warm_up()


def compute(task: Task) -> Outcome:
    """Read the job's mesh from the store and compute its signature.

    Raises
    ------
    MeshError
        If the mesh cannot be used.
    JobMemoryError
        If it asks for more memory than allowed.
    """
    parameters = Parameters.from_json(task.parameters)
    with StageClock() as clock:
        try:
            surface = _read(task.mesh, clock.begin)
            signature = compute_signature(surface, parameters, progress=clock.report, threads=1)
        except Exception as error:
            clock.tell()  # where it failed
            if isinstance(error, MemoryError):
                raise JobMemoryError("the mesh needs more memory than a job may use") from None
            raise
    return Outcome(PackedSignature.of(signature), surface.area, surface.report.as_dict(), clock.seconds())


def geodesics_from(mesh: StoredMesh, update: Update, source: int, target: int | None = None) -> Geodesics:
    """Return the geodesics of a stored mesh from one vertex of its file.

    Raises
    ------
    UnsuitedError
        If `source` or `target` is not a vertex of the file, vanished when it was simplified, or no path joins them.
    """
    surface = _read(mesh)
    start = surface_vertex(surface, source, "source")
    end = None if target is None else surface_vertex(surface, target, "target")
    distances = at_given_vertices(surface, geodesic_distances(surface, start, update=update, threads=1)[0])
    return Geodesics(
        distances=[float(distance) if np.isfinite(distance) else None for distance in distances],
        path=None if end is None else geodesic_path(surface, start, end).tolist(),
    )


def convert(mesh: StoredMesh, file_type: str) -> bytes:
    """Return a stored mesh in another format, as it was after reading and repair."""
    surface = _read(mesh)
    return write_mesh(surface.vertices, surface.faces, file_type)


def whole_form(mesh: StoredMesh, signature: Signature, file_type: str) -> bytes:
    """Return the canonical form of all vertices of a stored mesh, as a file."""
    return export_form(canonical_form(_read(mesh), signature=signature, threads=1), file_type)


def flattened(mesh: StoredMesh, parameters: Parameters, file_type: str) -> bytes:
    """Return a stored mesh with the texture coordinates of its flattening, as a file."""
    return export_flattening(flatten(_read(mesh), parameters, threads=1), file_type)


@dataclass(frozen=True)
class FileTask:
    """A file to make of a stored mesh."""

    mesh: StoredMesh
    call: str
    """A name of `FILE_CALLS`."""
    arguments: dict[str, Any]


def make_file(task: FileTask) -> bytes:
    """Make a file of a stored mesh, as a job."""
    with StageClock() as clock:
        clock.begin("reading")
        clock.tell()
        return FILE_CALLS[task.call](task.mesh, **task.arguments)


def _geodesics_file(mesh: StoredMesh, update: Update, source: int, target: int | None) -> bytes:
    found = geodesics_from(mesh, update, source, target)
    return json.dumps({"source": source, "distances": found.distances, "target": target, "path": found.path}).encode()


def _flattening_file(mesh: StoredMesh, parameters: dict[str, Any], file_type: str) -> bytes:
    return flattened(mesh, Parameters.from_dict(parameters), file_type)


def _form_file(mesh: StoredMesh, shape_id: str, file_type: str) -> bytes:
    return whole_form(mesh, _library(mesh.store_url).signature(shape_id), file_type)


FILE_CALLS: Final[Mapping[str, Callable[..., bytes]]] = {
    "mesh": convert,
    "signature": _form_file,
    "flattening": _flattening_file,
    "geodesics": _geodesics_file,
}
"""The functions that jobs of the kind "file" run, by name."""


def library_map(store_url: str, measure: str, parameters: Parameters | None, shown: Shown) -> dict[str, Any]:
    """Return `Library.map` as JSON has it."""
    return _library(store_url).map(measure, parameters=parameters, **asdict(shown)).as_dict()


def library_evaluation(store_url: str, measure: str, parameters: Parameters | None) -> dict[str, Any]:
    """Return `Library.evaluation` as JSON has it."""
    return _library(store_url).evaluation(measure, parameters=parameters).as_dict()


def warm_up() -> None:
    """Compile or load every kernel by comparing two small signatures."""
    first, second = (
        compute_signature(read_mesh(_TETRAHEDRON.format(height=height).encode()), threads=1) for height in (1, 2)
    )
    for measure in MEASURES:
        compare(first, second, measure)


def _read(mesh: StoredMesh, progress: Callable[[str], None] | None = None) -> Surface:
    with _library(mesh.store_url).store.read() as connection:
        data = get_mesh(connection, mesh.sha256)
    return read_mesh(data, file_type=mesh.file_type, policy=mesh.policy, limits=mesh.limits, progress=progress)


@cache
def _library(url: str) -> Library:
    must_be_there(url)
    return Library(url, migrate=False)
