"""Results that other processes compute, and a library stores without computing."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from io import BytesIO
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import numpy as np
import pytest

from tests.support.server import DAMAGED, ply, small_mesh
from unbend import Library, Parameters, compute_file, read_mesh
from unbend.errors import MeshMissingError, MeshReadError, ParameterError, ResultsError
from unbend.library.shape_rows import ComputedShape
from unbend.mesh.shapes import torus

SAMPLES = {"samples": 20}


@pytest.fixture(scope="module")
def pooled(tmp_path_factory) -> list[tuple[Path, ComputedShape]]:
    """Meshes, and their results from other processes, which also raise the errors of meshes."""
    folder = tmp_path_factory.mktemp("meshes")
    paths = [folder / f"{number}.ply" for number in range(3)]
    for number, path in enumerate(paths):
        path.write_bytes(small_mesh(number))
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        results = list(pool.map(compute_file, paths, [SAMPLES] * 3))
        with pytest.raises(MeshMissingError, match="No such file"):
            pool.submit(compute_file, folder / "missing.ply").result()
    return list(zip(paths, results, strict=True))


@pytest.fixture(scope="module")
def computed() -> ComputedShape:
    return compute_file(small_mesh(0), SAMPLES)


def test_a_library_stores_what_a_pool_has_computed_as_if_it_had_computed_it(library, pooled, tmp_path):
    added = [library.add_computed(path, result, label="ring") for path, result in pooled]
    assert [(shape.name, shape.label, shape.is_new) for shape in added] == [(str(n), "ring", True) for n in range(3)]
    with Library(str(tmp_path / "b.db")) as other:
        for (path, _), shape in zip(pooled, added, strict=True):
            stored = other.add(path, label="ring", parameters=SAMPLES)
            own = {"id", "created_at", "updated_at"}
            assert {k: v for k, v in shape.state.items() if k not in own} == {
                k: v for k, v in stored.state.items() if k not in own
            }
            assert library.mesh(shape.id) == path.read_bytes()
            assert np.array_equal(library.signature(shape.id).points, other.signature(stored.id).points)
        for measure in ("spectrum", "rigid", "partial"):
            rankings = [
                place.rank(small_mesh(1), measure=measure, parameters=SAMPLES).shapes for place in (library, other)
            ]
            found, expected = ([(match.name, match.distance) for match in shapes] for shapes in rankings)
            assert found == expected


def test_a_result_is_small_and_has_no_mesh(computed):
    large = compute_file(ply(torus(columns=200, rows=100)), SAMPLES)
    assert len(ForkingPickler.dumps(large)) < 100_000 < len(ply(torus(columns=200, rows=100)))
    assert ForkingPickler.loads(ForkingPickler.dumps(computed)) == computed
    assert repr(computed).startswith("ComputedShape(mesh 76d5ba09, samples=20, version 5")
    assert len(repr(computed)) < 100


@pytest.mark.parametrize("form", ["path", "text", "bytes", "file", "surface"])
def test_every_form_of_a_mesh_is_taken(library, tmp_path, form):
    path = tmp_path / "a.ply"
    path.write_bytes(small_mesh(0))
    forms = {
        "path": path, "text": str(path), "bytes": path.read_bytes(), "file": BytesIO(path.read_bytes()),
        "surface": read_mesh(path),
    }  # fmt: skip
    computed = compute_file(forms[form], SAMPLES, parts=False)
    if form == "file":
        forms[form].seek(0)
    assert library.add_computed(forms[form], computed).is_new


def test_a_known_shape_is_kept_or_updated(library, computed):
    first = library.add_computed(small_mesh(0), computed, label="a")
    kept = library.add_computed(small_mesh(0), computed, label="b")
    assert (kept.id, kept.is_new, kept.ignored) == (first.id, False, ("label",))
    changed = library.add_computed(small_mesh(0), computed, label="b", if_known="update")
    assert (changed.label, changed.updated, len(library)) == ("b", ("label",), 1)
    assert library.add(small_mesh(0), parameters=SAMPLES).id == first.id


def test_results_of_another_mesh_or_version_are_refused(library, computed):
    with pytest.raises(ResultsError, match="those of another mesh") as caught:
        library.add_computed(small_mesh(1), computed)
    assert "the mesh that compute_file got" in caught.value.advice
    with pytest.raises(ResultsError, match="version '4' of the algorithm, and this unbend has version '5'") as caught:
        library.add_computed(small_mesh(0), replace(computed, key=replace(computed.key, version="4")))
    assert "Compute the results again" in caught.value.advice
    with pytest.raises(ResultsError, match="an area"):
        library.add_computed(small_mesh(0), replace(computed, area=-1.0))
    more = replace(computed.key, parameters=Parameters(samples=21).to_json())
    with pytest.raises(ResultsError, match="other parameters"):
        library.add_computed(small_mesh(0), replace(computed, key=more))
    with pytest.raises(ParameterError, match="name"):
        library.add_computed(small_mesh(0), computed, name="x" * 300)
    assert len(library) == 0


def test_errors_of_meshes_are_those_of_reading(tmp_path, library, computed):
    with pytest.raises(MeshReadError):
        compute_file(DAMAGED)
    with pytest.raises(MeshMissingError):
        compute_file(tmp_path / "missing.ply")
    with pytest.raises(MeshMissingError):
        library.add_computed(tmp_path / "missing.ply", computed)
    with pytest.raises(ParameterError, match="threads"):
        compute_file(small_mesh(0), threads=0)
