"""Results that are computed in one process and stored by another: `compute_file`, and the checks before storing."""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
import zipfile
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats
from unbend.descriptors.reeb import LEVELS, ReebGraph
from unbend.embedding.dimension import MAX_DIMENSIONS
from unbend.errors import ParameterError, ResultsError
from unbend.library.packing import PackedSignature
from unbend.library.requests import UploadKey, decode_parameters, decode_policy
from unbend.library.shape_rows import ComputedShape
from unbend.local.signatures import LOCAL_VERSION, RUNGS
from unbend.mesh.formats import FORMATS
from unbend.mesh.policy import MeshPolicy, PolicyLike
from unbend.mesh.report import MeshReport
from unbend.mesh.sources import MeshSource, bytes_of
from unbend.signature.from_file import signature_of_file
from unbend.signature.parameters import MAX_SAMPLES, Parameters, ParametersLike
from unbend.signature.signature import ALGORITHM_VERSION
from unbend.tolerances import SHARES_SUM

LENGTHS: Final = {"spectrum": 120, "moments": 14, "distribution": 128, "dimension": 7, "surface_moments": 14}
"""Numbers in each descriptor; the length of "reeb" depends on the shape."""

_HASH: Final = re.compile(r"[0-9a-f]{64}")
_MOST_BYTES: Final = 2**25
"""Most bytes of the arrays of a signature. The largest, of 5000 samples, has far fewer."""
_SIGNATURE: Final = {"points": "<f8", "faces": "<i4", "samples": "<i8", "weights": "<f8"}
_LOCAL: Final = {"places": "<f4", "growth": "<f4", "reach": "<f4", "distances": "|u1"}
_FARTHEST_RUNG: Final = 4000
"""Bound of the first rung: the radii are then floats."""


def compute_file(
    source: MeshSource,
    parameters: ParametersLike = None,
    policy: PolicyLike = None,
    *,
    parts: bool = True,
    threads: int | None = None,
) -> ComputedShape:
    """Compute what a library stores of a mesh, in any process: `Library.add_computed` stores it without computing.

    The result can be pickled, and is small: it does not contain the mesh.

    Parameters
    ----------
    source : bytes, str, Path, binary file, Surface, pair of arrays, or mesh object
        A mesh, as `Library.add` takes it.
    parameters : Parameters or mapping, optional
        `Parameters()` by default.
    policy : MeshPolicy or mapping, optional
        How to read the mesh.
    parts : bool, default True
        Whether to compute the local signatures, too, by which pieces are recognised. They take about as long as the
        signature.
    threads : int, optional
        All cores by default. Take 1 if every core has a process. The result does not depend on it.

    Returns
    -------
    ComputedShape
        The same for the same input on every run.

    Raises
    ------
    MeshError
        As by `read_mesh` and `compute_signature`.
    ParameterError
        If a parameter is invalid, or `threads` is below 1.

    Examples
    --------
    >>> from concurrent.futures import ProcessPoolExecutor
    >>> with ProcessPoolExecutor() as pool, Library("shapes.db") as library:          # doctest: +SKIP
    ...     for path, computed in zip(paths, pool.map(compute_file, paths)):
    ...         library.add_computed(path, computed, label=path.parent.name)
    """
    file = bytes_of(source)
    chosen = Parameters.of(parameters), MeshPolicy.of(policy)
    found = signature_of_file(file.data, *chosen, file_type=file.file_type, threads=threads, local=parts)
    return ComputedShape.of(UploadKey.of(hashlib.sha256(file.data).hexdigest(), *chosen), found)


def check_computed(computed: ComputedShape) -> None:
    """Check results as if a stranger had made them: after it, a library may store them and compute with them.

    It cannot check that a signature belongs to its surface, which only a computation shows.

    Raises
    ------
    ResultsError
        The message names the value that is wrong, or the other version of the algorithm.
    """
    check_key(computed.key)
    try:
        _check_report(computed.report)
        _must(_is_number(computed.area, 0.0) and computed.area > 0, "an area that is no positive number")
        _check_signature(computed)
        _check_vectors(computed.signature)
        if computed.signature.local is not None:
            _check_local(computed.signature.local, computed.area)
    except ResultsError:
        raise
    except Exception as error:  # a damaged archive raises all kinds of errors
        raise ResultsError(f"the results cannot be read: {error}") from error


def check_key(key: UploadKey) -> None:
    """Check what results are of; ResultsError if it is malformed, or of another version of the algorithm."""
    if key.version != ALGORITHM_VERSION:
        raise ResultsError(
            f"the results are of version {key.version!r:.20} of the algorithm, and this unbend has version "
            f"{ALGORITHM_VERSION!r}"
        )
    _must(bool(_HASH.fullmatch(key.sha256)), "a malformed hash")
    try:
        canonical = decode_parameters(key.parameters).to_json(), decode_policy(key.policy).to_json()
    except (ParameterError, TypeError) as error:
        raise ResultsError(f"the results cannot be read: {error}") from error
    _must((key.parameters, key.policy) == canonical, "parameters or a policy in another form than unbend writes")


def _check_signature(computed: ComputedShape) -> None:
    arrays, about = _archive(computed.signature.payload, _SIGNATURE)
    report = computed.report
    vertices = report["vertices"] if report["simplified_vertices"] is None else report["simplified_vertices"]
    _check_arrays(arrays, decode_parameters(computed.key.parameters), vertices)
    _check_values(about, computed.key, computed.signature)


def _check_arrays(arrays: Mapping[str, NDArray[Any]], chosen: Parameters, vertices: int) -> None:
    """Check the arrays of a signature of a surface with so many vertices."""
    points, faces, samples, weights = (arrays[name] for name in _SIGNATURE)
    _must(points.ndim == 2 and faces.ndim == 2 and faces.shape[1] == 3, "a signature whose arrays have wrong shapes")
    count, dimensions = points.shape
    _must(samples.shape == weights.shape == (count,), "a signature whose arrays have wrong lengths")
    _must(0 < count <= (MAX_SAMPLES if chosen.samples == "auto" else chosen.samples), "a wrong number of samples")
    most = MAX_DIMENSIONS if chosen.dimensions == "auto" else chosen.dimensions
    _must(0 < dimensions <= most, "a wrong number of dimensions")
    _must(bool(np.isfinite(points).all()), "points that are not finite")
    _must(_in_range(faces, count), "faces with missing corners")
    _must(_in_range(samples, vertices), "samples that are no vertices")
    _must(bool((weights >= 0).all()) and abs(float(weights.sum()) - 1) <= SHARES_SUM, "weights that are no shares")


def _check_values(about: Mapping[str, Any], key: UploadKey, packed: PackedSignature) -> None:
    """Check the JSON of a signature, and the values that the library also has in columns."""
    _must(about["parameters"] == decode_parameters(key.parameters).as_dict(), "a signature of other parameters")
    _must(packed.parameters == key.parameters, "a signature of other parameters")
    _must(about["version"] == packed.version == key.version, "a signature of another version")
    _must(_is_number(about["scale"], 0.0) and about["scale"] > 0, "a scale that is no positive number")
    _must(_is_number(about["stress"], 0.0) and about["stress"] == packed.stress, "a wrong stress")
    _must(_is_number(about["asymmetry"], 0.0), "a wrong asymmetry")
    boundary = about["boundary"]
    _must(boundary == packed.boundary and (boundary is None or _is_number(boundary, 0.0)), "a wrong boundary")
    warnings = about["warnings"]
    _must(_are_texts(warnings) and tuple(warnings) == packed.warnings, "wrong warnings")
    _must(len(about) == 7, "a signature with further values")


def _check_vectors(packed: PackedSignature) -> None:
    _must(packed.vectors.keys() == {*LENGTHS, "reeb"}, "other descriptors than this version computes")
    vectors = {name: np.frombuffer(data, "<f8") for name, data in packed.vectors.items()}
    for name, vector in vectors.items():
        _must(bool(np.isfinite(vector).all()), f"a descriptor {name} that is not finite")
        _must(len(vector) == LENGTHS.get(name, len(vector)), f"a descriptor {name} of a wrong length")
    dimension = float(vectors["dimension"][0])
    _must(dimension in range(1, MAX_DIMENSIONS + 1) and dimension == packed.dimension, "a wrong effective dimension")
    _check_reeb(vectors["reeb"])


def _check_reeb(vector: Floats) -> None:
    _must(len(vector) >= 2, "a graph of a wrong length")
    nodes, edges = (float(value) for value in vector[:2])
    _must(nodes.is_integer() and edges.is_integer() and min(nodes, edges) >= 0, "a graph of a wrong length")
    _must(len(vector) == 2 + 4 * nodes + 2 * edges, "a graph of a wrong length")
    with np.errstate(invalid="ignore"):  # a number that is too large for an index differs from it below
        graph = ReebGraph.unpack(vector)
    _must(_in_range(graph.intervals, 2 ** (LEVELS - 1)) and _in_range(graph.edges, int(nodes)), "a malformed graph")
    _must(bool((graph.pack() == vector).all()), "a malformed graph")


def _check_local(payload: bytes, area: float) -> None:
    arrays, about = _archive(payload, _LOCAL)
    places, growth, reach, distances = (arrays[name] for name in _LOCAL)
    count = len(places)
    _must(places.shape == (count, 3) and growth.shape == (count, RUNGS), "local signatures of a wrong shape")
    lengths = (count,), (count * (count - 1) // 2,)
    _must((reach.shape, distances.shape) == lengths, "local signatures of a wrong length")
    _must(bool(np.isfinite(places).all() and np.isfinite(growth).all()), "circles that are not finite")
    _must(bool((growth >= 0).all() and (reach >= 0).all()), "circles that are negative")
    first = about["first"]
    _must(type(first) is int and abs(first) <= _FARTHEST_RUNG, "a wrong first circle")
    _must(about["area"] == area and about["version"] == LOCAL_VERSION, "local signatures of another surface")
    _must(_is_number(about["step"], 0.0) and len(about) == 4, "wrong distances of circles")


def _archive(payload: bytes, kinds: Mapping[str, str]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the arrays of an npz file, which has exactly these with exactly these types, and its JSON."""
    with zipfile.ZipFile(io.BytesIO(payload)) as archive:
        members = archive.infolist()
        _must(sorted(each.filename for each in members) == sorted(f"{name}.npy" for name in (*kinds, "about")),
              "an archive of other arrays")  # fmt: skip
        _must(sum(each.file_size for each in members) <= _MOST_BYTES, "an archive that is too large")
    with np.load(io.BytesIO(payload), allow_pickle=False) as file:
        arrays = {name: file[name] for name in kinds}
        about = file["about"]
    _must(all(arrays[name].dtype == kind for name, kind in kinds.items()), "arrays of another type")
    _must(about.dtype == np.uint8, "arrays of another type")
    return arrays, json.loads(about.tobytes())


def _check_report(report: object) -> None:
    _must(isinstance(report, Mapping), "a report that is no object")
    values: Any = report
    known = {field.name: str(field.type) for field in fields(MeshReport)}
    _must(values.keys() == known.keys(), "a report with other fields than this version writes")
    for name, kind in known.items():
        _must(_REPORTED[kind](values[name]), f"a report with a wrong value of {name}")
    _must(values["file_type"] in FORMATS, "a report of an unknown format")


def _is_number(value: object, least: float = -math.inf) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value >= least


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < 2**63


def _are_texts(value: object) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(each, str) for each in value)


_REPORTED: Final = {
    "str": lambda value: isinstance(value, str),
    "int": _is_count,
    "float": _is_number,
    "int | None": lambda value: value is None or _is_count(value),
    "float | None": lambda value: value is None or _is_number(value),
    "tuple[str, ...]": _are_texts,
}
"""Checks of the values of a report, by their annotation."""


def _in_range(indices: NDArray[Any], count: int) -> bool:
    return not indices.size or bool(indices.min() >= 0 and indices.max() < count)


def _must(condition: bool, otherwise: str) -> None:
    if not condition:
        raise ResultsError(f"the results have {otherwise}")
