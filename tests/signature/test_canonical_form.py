"""The canonical form: equal to the signature at its samples, and as accurate at other vertices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial.distance import pdist

from unbend import Parameters, Signature, Surface, canonical_form, compute_signature, embed, geodesic_matrix, read_mesh
from unbend.embedding.stress import stress
from unbend.errors import MeshGeometryError, ParameterError
from unbend.mesh.shapes import cylinder, s_bend, sheet, sphere, spiral, tetrahedron, torus
from unbend.signature import canonical_form as module

BENDINGS = {"cylinder": cylinder, "s": s_bend, "spiral": spiral}
METHODS = ["least_squares", "classical", "fast"]


def held_out(surface: Surface, signature: Signature) -> tuple[np.ndarray, np.ndarray]:
    """Return some vertices that are not samples, and the distances between them in the signature's unit."""
    others = np.setdiff1d(surface.used_vertices, signature.samples)
    chosen = np.random.default_rng(0).choice(others, 150, replace=False)
    return chosen, geodesic_matrix(surface, chosen) / signature.scale


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dimensions", [1, 3, 6])
@pytest.mark.parametrize("scaling", ["area", "box"])
def test_the_form_equals_the_signature_at_its_samples(method, dimensions, scaling):
    surface = torus(columns=40, rows=25)
    parameters = Parameters(samples=120, dimensions=dimensions, method=method, scaling=scaling)
    form, signature = canonical_form(surface, parameters), compute_signature(surface, parameters)
    assert form.points.shape == (len(surface.vertices), dimensions)
    np.testing.assert_array_equal(form.points[signature.samples], signature.points)
    np.testing.assert_array_equal(form.faces, surface.faces)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dimensions", [2, 3, 6])
def test_the_form_is_as_smooth_at_samples_as_at_other_vertices(method, dimensions):
    surface = torus(columns=60, rows=40)
    form = canonical_form(surface, Parameters(samples=150, dimensions=dimensions, method=method))
    count, (a, b, c) = len(surface.vertices), surface.faces.T
    ends = np.concatenate([a, b, c]), np.concatenate([b, c, a])
    around = csr_array((np.ones(len(ends[0])), ends), (count, count))
    around = around + around.T
    apart = np.linalg.norm(form.points - (around @ form.points) / around.sum(axis=1)[:, None], axis=1)
    sampled = np.isin(np.arange(count), form.signature.samples)
    assert np.median(apart[sampled]) < 3 * np.median(apart[~sampled])
    assert apart[sampled].max() < 2 * apart[~sampled].max()


@pytest.mark.parametrize("bending", BENDINGS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dimensions", [2, 3])
def test_every_vertex_of_a_bent_sheet_is_placed_isometrically_in_the_plane(bending, method, dimensions):
    flat, bent = sheet(columns=60, rows=30), BENDINGS[bending](columns=60, rows=30)
    form = canonical_form(bent, Parameters(method=method, dimensions=dimensions))
    some = np.random.default_rng(0).choice(len(flat.vertices), 300, replace=False)
    true = pdist(flat.vertices[some]) / form.signature.scale
    assert np.abs(pdist(form.points[some]) - true).max() < 1e-3 * true.max()
    third = form.surface.vertices[:, 2]
    assert np.ptp(third) < 2e-3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dimensions", [2, 3, 5])
def test_vertices_between_the_samples_have_hardly_more_stress_than_an_embedding(method, dimensions):
    surface = torus(columns=60, rows=40)
    form = canonical_form(surface, Parameters(method=method, dimensions=dimensions))
    chosen, distances = held_out(surface, form.signature)
    itself = embed(distances, dimensions, method=method).stress
    assert stress(form.points[chosen], distances) < 1.15 * max(itself, form.signature.stress)


@pytest.mark.parametrize("mesh", ["single/spot.obj", "tosca5k/cat0.off"])
@pytest.mark.parametrize("dimensions", [2, 3, 8])
def test_vertices_of_real_meshes_have_hardly_more_stress_than_an_embedding(shared_data, mesh, dimensions):
    surface = read_mesh(shared_data / mesh)
    form = canonical_form(surface, Parameters(dimensions=dimensions))
    chosen, distances = held_out(surface, form.signature)
    itself = embed(distances, dimensions).stress
    assert stress(form.points[chosen], distances) < 1.2 * max(itself, form.signature.stress)


def test_few_landmarks_suffice_when_memory_is_limited(monkeypatch):
    surface = torus(columns=60, rows=40)
    signature = compute_signature(surface)
    many = canonical_form(surface, signature=signature)
    monkeypatch.setattr(module, "_ROWS_BYTES", 25 * 4 * len(surface.vertices))
    assert module._landmark_count(surface, signature) == 25
    few = canonical_form(surface, signature=signature)
    np.testing.assert_array_equal(few.points[signature.samples], signature.points)
    chosen, distances = held_out(surface, signature)
    assert stress(few.points[chosen], distances) < 1.02 * stress(many.points[chosen], distances)
    monkeypatch.setattr(module, "_ROWS_BYTES", 0)
    assert module._landmark_count(surface, signature) == 8


def test_a_given_signature_is_not_computed_again(monkeypatch):
    surface = torus(columns=30, rows=20)
    form = canonical_form(surface, Parameters(samples=60))
    monkeypatch.delattr(module, "compute_signature")
    again = canonical_form(surface, signature=form.signature)
    np.testing.assert_array_equal(again.points, form.points)
    assert again.signature is form.signature


def test_forms_do_not_depend_on_the_run_or_the_number_of_threads():
    surface = torus(columns=30, rows=20)
    first = canonical_form(surface, Parameters(samples=60))
    for threads in (1, 5):
        again = canonical_form(surface, Parameters(samples=60), threads=threads)
        np.testing.assert_array_equal(again.points, first.points)


def test_the_unit_of_length_does_not_change_the_form():
    surface = torus(columns=30, rows=20)
    form = canonical_form(surface, Parameters(samples=60))
    for factor in (2.0**-100, 2.0**100):
        scaled = canonical_form(Surface(factor * surface.vertices, surface.faces), Parameters(samples=60))
        np.testing.assert_allclose(scaled.points, form.points, atol=1e-9)


@pytest.mark.parametrize("dimensions", [1, 3, 12])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "surface",
    [tetrahedron(), Surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), sphere(subdivisions=1)],
    ids=["tetra", "triangle", "sphere"],
)
def test_the_form_equals_the_signature_if_every_vertex_is_a_sample(surface, method, dimensions):
    form = canonical_form(surface, Parameters(method=method, dimensions=dimensions))
    np.testing.assert_array_equal(form.points[form.signature.samples], form.signature.points)
    assert np.isfinite(form.points).all()


def test_vertices_without_a_face_are_nan():
    surface = torus(columns=20, rows=12)
    loose = Surface(
        np.vstack([surface.vertices[:5], [[9, 9, 9]], surface.vertices[5:]]), surface.faces + (surface.faces > 4)
    )
    form, plain = canonical_form(loose, Parameters(samples=50)), canonical_form(surface, Parameters(samples=50))
    assert np.isnan(form.points[5]).all()
    np.testing.assert_allclose(np.delete(form.points, 5, axis=0), plain.points, atol=1e-9)
    assert len(form.surface.used_vertices) == len(surface.vertices)


def test_invalid_arguments_are_refused():
    surface = torus(columns=20, rows=12)
    signature = compute_signature(surface, Parameters(samples=50))
    with pytest.raises(ParameterError, match="its own"):
        canonical_form(surface, Parameters(), signature=signature)
    with pytest.raises(ParameterError, match="another surface"):
        canonical_form(tetrahedron(), signature=signature)
    with pytest.raises(ParameterError, match="threads"):
        canonical_form(surface, threads=0)
    with pytest.raises(MeshGeometryError, match="area"):
        canonical_form(Surface(np.zeros((3, 3)), [[0, 1, 2]]))


def test_forms_are_read_only():
    form = canonical_form(tetrahedron())
    with pytest.raises(ValueError, match="read-only"):
        form.points[0] = 0
