"""Matching of surfaces whose true correspondence is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.correspondence.bodies import blob, errors
from unbend import (
    MeshPolicy,
    Surface,
    geodesic_distances,
    match,
    read_mesh,
    symmetry,
    transfer,
    transfer_landmarks,
)
from unbend.errors import MeshGeometryError, ParameterError, UnsuitedError
from unbend.mesh.shapes import cylinder, ellipsoid, sheet
from unbend.mesh.write import write_mesh


@pytest.fixture(scope="module")
def body() -> Surface:
    return blob()


def test_a_surface_matches_itself(body):
    found = match(body, body)
    assert errors(found, body, body.vertices).mean() < 0.002
    assert found.oriented
    assert not found.ambiguous
    assert found.residual < 0.002
    assert found.confidence.min() > 0.8


def test_order_place_and_size_do_not_matter(body, rotation):
    generator = np.random.default_rng(1)
    order = generator.permutation(len(body.vertices))
    numbers = np.argsort(order)
    faces = numbers[body.faces][generator.permutation(len(body.faces))]
    other = Surface(7.0 * body.vertices[order] @ rotation(3) + 5.0, faces)
    found = match(body, other)
    assert errors(found, other, other.vertices[numbers]).mean() < 0.005
    assert found.oriented


def test_orientation_tells_a_body_from_its_mirror_image(body):
    mirrored = Surface(body.vertices * (1, 1, -1), body.faces[:, ::-1])
    right = match(body, mirrored, orientation="reverse")
    assert errors(right, mirrored, mirrored.vertices).mean() < 0.005
    assert right.oriented
    kept = match(body, mirrored)
    assert errors(kept, mirrored, mirrored.vertices).mean() > 0.1
    assert kept.residual > 3 * right.residual


def test_faces_that_show_inwards_are_turned(body):
    inward = Surface(body.vertices, body.faces[:, ::-1])
    found = match(body, inward)
    assert errors(found, inward, body.vertices).mean() < 0.005
    assert found.oriented


def test_a_rolled_sheet_matches_the_flat_one():
    flat, rolled = sheet(columns=41, rows=21), cylinder(columns=41, rows=21)
    found = match(flat, rolled)
    turned = flat.vertices.mean(axis=0) * 2 - flat.vertices  # half a turn is as good as none
    half = np.array([np.linalg.norm(flat.vertices - place, axis=1).argmin() for place in turned])
    truth = min(errors(found, rolled, rolled.vertices[order]).mean() for order in (np.arange(len(half)), half))
    assert truth < 0.02
    assert found.ambiguous


def test_a_symmetric_body_is_ambiguous():
    assert match(ellipsoid((1.0, 0.7, 0.4)), ellipsoid((1.0, 0.7, 0.4))).ambiguous


def test_the_symmetry_of_an_ellipsoid_is_a_mirror_image():
    surface = ellipsoid((1.0, 0.7, 0.4), subdivisions=4)
    found = symmetry(surface)
    places = transfer(found, surface.vertices)
    assert np.abs(np.abs(places) - np.abs(surface.vertices)).mean() < 0.02
    signs = np.sign((places * surface.vertices).sum(axis=0))
    assert np.prod(signs) == -1  # one or three axes are reversed
    assert found.oriented


def test_the_residual_tells_symmetric_from_asymmetric(body):
    assert symmetry(body).residual > 3 * symmetry(ellipsoid((1.0, 0.7, 0.4), subdivisions=4)).residual


def test_every_run_gives_the_same(body):
    first, second = match(body, ellipsoid(), samples=100), match(body, ellipsoid(), samples=100, threads=2)
    assert np.array_equal(first.faces, second.faces)
    assert np.array_equal(first.barycentric, second.barycentric)


def test_vertices_without_faces_have_no_point(body):
    more = Surface(np.vstack([body.vertices, [[9.0, 9.0, 9.0]]]), body.faces)
    found = match(more, more, samples=100)
    assert found.faces[-1] == -1
    assert np.isnan(found.barycentric[-1]).all()
    assert found.confidence[-1] == 0
    assert found.vertices[-1] == -1
    assert found.matched.sum() == len(body.vertices)
    assert np.isnan(transfer(found, more.vertices)[-1]).all()
    assert transfer(found, np.arange(len(more.vertices)))[-1] == 0
    assert (found.vertices < len(body.vertices)).all()


def test_separate_components_are_refused(body):
    two = Surface(
        np.vstack([body.vertices, body.vertices + 9]), np.vstack([body.faces, body.faces + len(body.vertices)])
    )
    with pytest.raises(MeshGeometryError, match="not connected"):
        match(two, body)


def test_faces_without_common_sides_decide_nothing(body):
    faces = body.faces.copy()
    faces[::7] = faces[::7, ::-1]
    mixed = Surface(body.vertices, faces)
    found = match(body, mixed)
    assert not found.oriented
    assert errors(found, mixed, body.vertices).mean() < 0.02  # no other map of this body keeps distances
    with pytest.raises(UnsuitedError, match="sides"):
        symmetry(mixed)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"samples": 5}, "samples must be"),
        ({"orientation": "left"}, "orientation must be"),
        ({"threads": 0}, "threads"),
    ],
)
def test_arguments_out_of_range_are_refused(body, wrong, words):
    with pytest.raises(ParameterError, match=words):
        match(body, body, **wrong)


def test_tiny_meshes_have_a_match():
    tetrahedron = Surface(np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    found = match(tetrahedron, tetrahedron)
    assert found.matched.all()


@pytest.fixture(scope="module")
def to_itself(body):
    return match(body, body, samples=100)


def test_fields_labels_and_landmarks_are_carried(body, to_itself):
    assert transfer(to_itself, np.ones(len(body.vertices))) == pytest.approx(1.0)
    labels = np.where(body.vertices[:, 0] > 0, "front", "back")
    assert (transfer(to_itself, labels) == labels).mean() > 0.97
    assert transfer(to_itself, body.vertices[:, 0] > 0).dtype == bool
    wanted = np.array([3, 77, 1200])
    carried = transfer_landmarks(to_itself, wanted)
    apart = geodesic_distances(body, wanted)[np.arange(3), carried] / np.sqrt(body.area)
    assert apart.max() < 0.03


def test_values_of_another_mesh_are_refused(body, to_itself):
    with pytest.raises(ParameterError, match="one row for each"):
        transfer(to_itself, np.ones(5))
    with pytest.raises(ParameterError, match="no vertex 999999"):
        transfer_landmarks(to_itself, [999999])
    with pytest.raises(ParameterError, match="vertex indices"):
        transfer_landmarks(to_itself, [0.5])


@settings(max_examples=5)
@given(st.tuples(*[st.floats(0.3, 2.0)] * 3), st.tuples(*[st.floats(0.3, 2.0)] * 3))
def test_every_result_is_a_point_of_the_surface(one, other):
    a, b = ellipsoid(one, subdivisions=2), ellipsoid(other, subdivisions=2)
    found = match(a, b, samples=60)
    assert ((found.faces >= 0) & (found.faces < len(b.faces))).all()
    assert (found.barycentric >= 0).all()
    assert found.barycentric.sum(axis=1) == pytest.approx(1.0)
    assert ((found.confidence >= 0) & (found.confidence <= 1)).all()
    low, high = b.vertices.min(axis=0), b.vertices.max(axis=0)
    places = transfer(found, b.vertices)
    assert ((places >= low - 1e-9) & (places <= high + 1e-9)).all()


@pytest.mark.parametrize(
    ("folder", "one", "other", "most"),
    [
        ("faust5k", "tr_reg_002", "tr_reg_032", 0.03),
        ("tosca5k", "david0", "david1", 0.03),
        ("tosca5k", "cat0", "cat7", 0.04),
    ],
)
def test_real_bodies_match(shared_data, folder, one, other, most):
    a, b = (read_mesh(shared_data / folder / f"{name}.off", policy=MeshPolicy()) for name in (one, other))
    found = match(a, b)
    truth = [np.loadtxt(shared_data / folder / "corres" / f"{name}.vts", dtype=int) - 1 for name in (one, other)]
    truth = [
        each if mesh.vertex_map is None else mesh.vertex_map[each] for each, mesh in zip(truth, (a, b), strict=True)
    ]
    points = np.random.default_rng(0).choice(len(truth[0]), 200, replace=False)
    far = geodesic_distances(b, truth[1][points])[np.arange(200), found.vertices[truth[0][points]]] / np.sqrt(b.area)
    assert far.mean() < most
    assert found.oriented
    trusted = found.confidence[truth[0][points]] > np.median(found.confidence)
    assert far[trusted].mean() < far[~trusted].mean()


def test_the_mesh_of_a_result_can_be_written(body, to_itself):
    from unbend.correspondence.export import export_correspondence

    surface = read_mesh(export_correspondence(to_itself, body, body, "ply"))
    assert len(surface.vertices) == len(body.vertices)
    assert write_mesh(body.vertices, body.faces, "off") != export_correspondence(to_itself, body, body, "off")
