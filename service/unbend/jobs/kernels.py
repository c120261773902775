"""Compiles every kernel that jobs and requests use, for images whose disk is read-only.

`worker.warm_up` loads only the common kernels, because each worker waits for it. `compile_kernels` runs each kind of
job, on small meshes that take the rare ways too: thin triangles, seams, several components, simplification.
"""

from __future__ import annotations

import contextlib
import itertools
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Final, get_args

import numpy as np

from unbend.arrays import Floats
from unbend.correspondence.match import Turn
from unbend.embedding.embed import Method
from unbend.embedding.weighting import Weighting
from unbend.errors import ParameterError, UnsuitedError
from unbend.geodesics.contours import iso_contours
from unbend.geodesics.distances import Update
from unbend.geodesics.paths.shortest import geodesic_path
from unbend.jobs import worker
from unbend.jobs.batch import Batch
from unbend.jobs.worker import StoredMesh
from unbend.library import Library
from unbend.library.requests import RANKING_MEASURES, FileCall, FileRequest, QueryRequest
from unbend.library.search import MapOptions
from unbend.matching.classification import CLASSIFIERS
from unbend.matching.measures import DEFAULT_MEASURE
from unbend.mesh.formats import WRITTEN
from unbend.mesh.limits import MeshLimits
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh
from unbend.mesh.shapes import bent_tube, ellipsoid, sheet, torus
from unbend.mesh.subdivide import subdivided
from unbend.mesh.surface import Surface
from unbend.mesh.write import write_mesh
from unbend.render.colours import ThemeName
from unbend.render.display import MOST_FACES
from unbend.render.request import PictureRequest, Subject
from unbend.results.maps import MapDistance
from unbend.results.shapes import ShapeRecord
from unbend.signature.parameters import Parameters, Scaling
from unbend.signature.signature import Signature
from unbend.threads import available_cores

_PARAMETERS: Final = Parameters(samples=24)
_LIMITS: Final = MeshLimits()
_PIXELS: Final = 32


def compile_common_kernels() -> None:
    """Compile the kernels of `worker.warm_up` in two processes, which share the work: about a minute."""
    with Batch(min(2, available_cores())) as batch:
        for done in [batch.submit(worker.warm_up, number) for number in range(batch.size)]:
            done.result()


def compile_kernels() -> None:
    """Compile every kernel, or load it if the cache has it; a minute or two without a cache."""
    compile_common_kernels()
    worker.warm_up()
    with tempfile.TemporaryDirectory() as folder, Library(str(Path(folder, "kernels.db"))) as library:
        shapes = [
            library.add(surface, label=label, parameters=_PARAMETERS)
            for label, surfaces in _classes().items()
            for surface in surfaces
        ]
        for data, policy in _files():
            library.add(data, parameters=_PARAMETERS, policy=policy)
        for parameters in _parameters():
            library.add(_as_ply(_ring()), parameters=parameters)
        whole = library.add(bent_tube(length=4.0, radius=0.3, around=12, along=40), parameters=_PARAMETERS)
        piece = library.add(_piece(read_mesh(library.mesh(whole.id))), parameters=_PARAMETERS)
        for shape, other in ((shapes[0], shapes[1]), (piece, whole)):
            _make_files(library, shape, other)
            _draw(library, shape)
        for shape in (shapes[0], piece, whole):
            _search(library, shape)
    geodesic_path(Surface(np.eye(3), np.array([[0, 0, 1]])), 0, 1)  # the way along edges
    iso_contours(_ring(), _ring().vertices[:, 0], [0.5])


def _classes() -> dict[str, list[Surface]]:
    """Return surfaces of three classes: with a handle, closed, and with a boundary."""
    return {
        "ring": [_ring(minor) for minor in (0.2, 0.25, 0.3)],
        "tube": [bent_tube(length=length, radius=0.3, around=8, along=8) for length in (1.5, 2.0, 2.5)],
        "sheet": [sheet(width=width, columns=9, rows=7) for width in (1.0, 1.2, 1.4)],
    }


def _ring(minor: float = 0.4) -> Surface:
    return torus(minor=minor, columns=14, rows=8)


def _files() -> Iterator[tuple[bytes, MeshPolicy]]:
    """Return files of each format, and files that need repairs."""
    ring, ball = _ring(), ellipsoid(subdivisions=2)
    for file_type in WRITTEN:
        yield write_mesh(ring.vertices, ring.faces, file_type), MeshPolicy(seams="keep")
    yield _as_ply(_soup(ball.vertices[ball.faces])), MeshPolicy()
    corner = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0]])[[[0, 3, 2], [0, 2, 1], [0, 1, 3], [1, 2, 3]]]
    yield _as_ply(_soup(np.concatenate([corner, corner * [-1, -1, 1]]))), MeshPolicy()  # two solids touch at an edge
    yield _mixed_polygons(), MeshPolicy()
    thin = sheet(columns=9, rows=7)
    yield _as_ply(Surface(thin.vertices * [1.0, 0.02, 1.0], thin.faces)), MeshPolicy()
    apart = Surface(
        np.concatenate([ring.vertices, np.add(ball.vertices, [5.0, 0.0, 0.0])]),
        np.concatenate([ring.faces, ball.faces + len(ring.vertices)]),
    )
    yield _as_ply(apart), MeshPolicy(components="bridge", smooth=2)
    yield _as_ply(Surface(*subdivided(ball.vertices, ball.faces))), MeshPolicy(max_vertices=80)


def _soup(corners: Floats) -> Surface:
    """Return triangles (t, 3, 3) that share no vertices."""
    return Surface(corners.reshape(-1, 3).astype(float), np.arange(3 * len(corners)).reshape(-1, 3))


def _mixed_polygons() -> bytes:
    """Return a pyramid as a binary ply file, with faces of different sizes."""
    fields = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex 5\n{fields}element face 5\n"
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]], "<f4")
    faces = bytes([4, 0, 3, 2, 1, 3, 0, 1, 4, 3, 1, 2, 4, 3, 2, 3, 4, 3, 3, 0, 4])
    return f"{head}property list uchar uchar vertex_indices\nend_header\n".encode() + points.tobytes() + faces


def _as_ply(surface: Surface) -> bytes:
    return write_mesh(surface.vertices, surface.faces, "ply")


def _piece(surface: Surface) -> Surface:
    """Return a quarter of a closed surface, around its first vertex."""
    far = np.linalg.norm(surface.vertices - surface.vertices[0], axis=1)[surface.faces].max(axis=1)
    faces = surface.faces[np.argsort(far)[: len(surface.faces) // 4]]
    used, numbers = np.unique(faces, return_inverse=True)
    return Surface(surface.vertices[used], numbers.reshape(-1, 3))


def _parameters() -> Iterator[Parameters]:
    for method, weights in itertools.product(get_args(Method), get_args(Weighting)):
        with contextlib.suppress(ParameterError):  # some methods have no weights
            yield replace(_PARAMETERS, method=method, weights=weights)
    for update, scaling in itertools.product(get_args(Update), get_args(Scaling)):
        yield replace(_PARAMETERS, update=update, scaling=scaling, dimensions="auto", starts=1)
    yield Parameters(samples="auto", first_sample="random")


def _make_files(library: Library, shape: ShapeRecord, other: ShapeRecord) -> None:
    """Make each kind of file that a job makes of a stored shape."""
    parameters = shape.parameters.as_dict()
    requests: list[tuple[FileCall, dict[str, object]]] = [
        ("mesh", {"file_type": "glb"}),
        ("signature", {"shape_id": shape.id, "file_type": "ply"}),
        ("flattening", {"parameters": parameters, "file_type": "obj"}),
        *(("geodesics", {"update": update, "source": 0, "target": 20}) for update in get_args(Update)),
        *(
            ("match", {"other_id": other.id, "orientation": turn, "samples": 40, "file_type": file_type})
            for turn, file_type in itertools.product(get_args(Turn), ("json", "ply"))
        ),
    ]
    for call, arguments in requests:
        worker.make_file(_stored(library, shape), FileRequest(call, arguments, "", shape.name))


def _draw(library: Library, shape: ShapeRecord) -> None:
    """Make what viewers show of a stored shape."""
    mesh, signature = _stored(library, shape), library.signature(shape.id)
    worker.viewer_file(mesh, signature, MOST_FACES)
    worker.geodesic_floats(mesh, "spherical", 0)
    for subject, theme in itertools.product(get_args(Subject), get_args(ThemeName)):
        form = None if subject == "surface" else signature
        request = PictureRequest(width=_PIXELS, height=_PIXELS, subject=subject, theme=theme)
        for asked in (request, replace(request, distances_from=0, contours=True, path=(0, 20))):
            worker.draw_picture(mesh, form, asked)


def _search(library: Library, shape: ShapeRecord) -> None:
    """Rank a stored shape and a query in each way, and describe the whole library."""
    outcome = worker.compute_query(_stored(library, shape), shape.parameters, local=True)
    query = ForkingPickler.loads(ForkingPickler.dumps(outcome)).signature  # as it arrives from a worker
    queries: list[Signature | str] = [query, shape.id]
    for asked, measure, classifier in itertools.product(queries, RANKING_MEASURES, CLASSIFIERS):
        with contextlib.suppress(ParameterError, UnsuitedError):  # parts have one classifier
            library.search.rank(asked, QueryRequest(measure, classifier, k=3))
    for distance in get_args(MapDistance):
        worker.library_map(library.address, DEFAULT_MEASURE, shape.parameters, MapOptions(distance=distance))
    worker.library_evaluation(library.address, DEFAULT_MEASURE, shape.parameters)


def _stored(library: Library, shape: ShapeRecord) -> StoredMesh:
    return StoredMesh(library.address, shape.sha256, shape.file_type, shape.policy, _LIMITS)
