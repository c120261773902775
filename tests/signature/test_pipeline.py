"""Signatures: nearly equal for isometric surfaces, and independent of pose, numbering and scale."""

from __future__ import annotations

import io
import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from unbend import (
    Parameters,
    Surface,
    compare,
    compute_signature,
    effective_dimension,
    geodesic_matrix,
    read_mesh,
)
from unbend.descriptors.moments import moments
from unbend.descriptors.quadrature import surface_quadrature
from unbend.errors import MeshGeometryError, ParameterError
from unbend.mesh.shapes import cylinder, ellipsoid, helicoid_catenoid, s_bend, sheet, sphere, spiral, tetrahedron, torus
from unbend.progress import STAGES, Progress
from unbend.signature.export import export_signature

BENDINGS = {"cylinder": cylinder, "s": s_bend, "spiral": spiral}
TRIANGLE = Surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


def sizes(level: int) -> dict[str, int]:
    return {"columns": 12 * 2**level, "rows": 6 * 2**level}


def test_asymmetric_distances_are_a_warning(labelled):
    ball = sphere(subdivisions=2)
    south = int(ball.vertices[:, 2].argmin())
    pinched = Surface(ball.vertices, np.where(ball.faces == south, 0, ball.faces))  # merges two vertices far apart
    signature = compute_signature(pinched)
    assert signature.asymmetry > 0.05
    assert any(f"differ by {signature.asymmetry:.0%} of the largest" in warning for warning in signature.warnings)
    for dataset in ("shrec11_simplified", "tosca5k"):
        for path, _ in labelled(dataset)[::40]:
            assert compute_signature(read_mesh(path), Parameters(samples=100)).warnings == ()


@pytest.mark.parametrize("bending", BENDINGS)
def test_moments_of_isometric_sheets_agree_better_on_finer_meshes(bending):
    differences = []
    for level in (0, 1, 2):
        flat = compute_signature(sheet(**sizes(level)), Parameters(samples=80))
        bent = compute_signature(BENDINGS[bending](**sizes(level)), Parameters(samples=80))
        differences.append(np.abs(flat.moments - bent.moments).max() / flat.moments.max())
    assert differences[0] < 0.1
    assert differences[2] < 0.006
    assert differences[2] < 0.5 * differences[0]


@pytest.mark.parametrize("bending", BENDINGS)
def test_signatures_of_bent_sheets_are_the_flat_sheet(bending):
    every = Parameters(samples=5000)
    flat, bent = compute_signature(sheet(**sizes(1)), every), compute_signature(BENDINGS[bending](**sizes(1)), every)
    order, other = np.argsort(flat.samples), np.argsort(bent.samples)
    difference = np.abs(pdist(flat.points[order]) - pdist(bent.points[other])).max() / pdist(flat.points).max()
    assert difference < 0.012
    assert np.ptp(bent.points[:, 2]) < 0.05 * np.ptp(bent.points[:, 0])  # a developable surface needs no third axis
    assert flat.stress < 1e-6
    assert bent.stress < 1e-4


def test_the_helicoid_and_the_catenoid_have_similar_signatures():
    surfaces = [helicoid_catenoid(t, columns=48, rows=32) for t in (0.0, np.pi / 4, np.pi / 2)]
    helicoid, between, catenoid = (compute_signature(surface, Parameters(samples=200)) for surface in surfaces)
    other = compute_signature(sheet(columns=48, rows=32), Parameters(samples=200))
    for measure in ("spectrum", "moments", "distribution"):
        apart = max(compare(helicoid, catenoid, measure), compare(helicoid, between, measure))
        assert apart < 0.2 * compare(helicoid, other, measure), measure
    assert compare(helicoid, catenoid, "surface_moments") > compare(helicoid, catenoid, "moments")


FAMILIES = {
    "sheet": [
        lambda k, make=make: make(columns=20 * k, rows=10 * k) for make in (sheet, cylinder, s_bend, spiral)
    ],
    "helicoid": [
        lambda k, t=t: helicoid_catenoid(t, columns=30 * k, rows=10 * k) for t in (0.0, np.pi / 4, np.pi / 2)
    ],
}  # fmt: skip


@pytest.mark.parametrize("family", FAMILIES)
def test_isometric_surfaces_differ_less_than_twice_the_effect_of_the_mesh(family):
    """The effect of the mesh is the distance between a surface and its finer mesh, as in the benchmark `isometric`."""
    signatures = [[compute_signature(bending(k)) for bending in FAMILIES[family]] for k in (1, 2, 4)]
    for coarse, fine in itertools.pairwise(signatures):
        for measure in ("spectrum", "combined", "moments", "distribution", "rigid", "hausdorff"):
            apart = max(compare(*pair, measure) for pair in itertools.combinations(coarse, 2))
            mesh = max(compare(*pair, measure) for pair in zip(coarse, fine, strict=True))
            assert apart < 2 * mesh, (measure, len(coarse[0].points))


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 100.0), st.booleans())
def test_signatures_do_not_depend_on_pose_reflection_scale_or_numbering(rotation, seed, factor, mirrored):
    surface = ellipsoid((1.0, 0.75, 0.5), subdivisions=2)  # three different axes give a unique pose
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(surface.vertices))
    vertices = factor * surface.vertices @ rotation(seed).T + rng.normal(size=3)
    faces = np.argsort(order)[surface.faces]
    moved = Surface(vertices[order] * ([1, 1, -1] if mirrored else 1), faces[:, ::-1] if mirrored else faces)
    a, b = compute_signature(surface), compute_signature(moved)
    for measure in ("spectrum", "moments", "distribution", "surface_moments"):
        # SMACOF stops within its tolerance, and symmetric surfaces have several equally good forms.
        assert compare(a, b, measure) < 1e-3 * np.abs(a.descriptors[measure]).sum(), measure
    assert b.scale == pytest.approx(factor * a.scale)
    assert b.stress == pytest.approx(a.stress, rel=5e-3)


def test_signatures_do_not_depend_on_the_run_or_the_number_of_threads():
    surface = torus(columns=30, rows=20)
    first = compute_signature(surface)
    for threads in (1, 2, 5):
        again = compute_signature(surface, threads=threads)
        np.testing.assert_array_equal(again.points, first.points)
        for name, vector in first.descriptors.items():
            np.testing.assert_array_equal(again.descriptors[name], vector)


def test_the_faces_are_those_of_the_surface_if_every_vertex_is_a_sample():
    surface = sphere(subdivisions=2)
    signature = compute_signature(surface)
    assert len(signature.points) == len(surface.vertices)
    own = {tuple(sorted(face)) for face in surface.faces.tolist()}
    assert {tuple(sorted(face)) for face in signature.samples[signature.faces].tolist()} == own


def test_the_signature_of_a_sphere_is_closed():
    signature = compute_signature(sphere(subdivisions=4), Parameters(samples=100))
    edges = np.sort(signature.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    kinds, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 2).all()
    assert 100 - len(kinds) + len(signature.faces) == 2


def test_weights_sum_to_one_and_points_are_in_the_principal_pose():
    signature = compute_signature(torus(columns=40, rows=25), Parameters(samples=150))
    assert signature.weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(signature.weights @ signature.points, 0, atol=1e-12)
    second = (signature.points * signature.weights[:, None]).T @ signature.points
    np.testing.assert_allclose(second, np.diag(np.diagonal(second)), atol=1e-12)
    assert (np.diff(np.diagonal(second)) <= 0).all()
    points, weights = surface_quadrature(signature.points, signature.faces, signature.weights)
    np.testing.assert_allclose(signature.moments, moments(points, weights), rtol=1e-9)


def test_box_scaling_makes_the_longest_side_one_and_keeps_descriptors():
    surface = torus(columns=30, rows=20)
    box, area = compute_signature(surface, Parameters(scaling="box")), compute_signature(surface)
    assert np.ptp(box.points, axis=0).max() == pytest.approx(1.0)
    assert area.scale == pytest.approx(np.sqrt(surface.area))
    np.testing.assert_allclose(box.points * box.scale, area.points * area.scale, atol=1e-12)
    np.testing.assert_array_equal(box.moments, area.moments)


@pytest.mark.parametrize(
    "surface", [tetrahedron(), TRIANGLE, sheet(columns=3, rows=2)], ids=["tetra", "triangle", "sheet"]
)
@pytest.mark.parametrize("dimensions", [1, 2, 3, 5])
def test_the_smallest_surfaces_have_signatures(surface, dimensions):
    signature = compute_signature(surface, Parameters(dimensions=dimensions))
    assert signature.points.shape == (len(surface.vertices), dimensions)
    assert np.isfinite(signature.points).all()
    assert all(np.isfinite(vector).all() for vector in signature.descriptors.values())


def test_auto_dimensions_are_the_effective_dimension():
    auto = Parameters(samples=100, dimensions="auto")
    assert compute_signature(sheet(columns=24, rows=12), auto).points.shape == (100, 2)
    for surface in (torus(columns=30, rows=20), ellipsoid((1.0, 0.6, 0.4), subdivisions=3)):
        samples = compute_signature(surface, auto).samples
        expected = effective_dimension(geodesic_matrix(surface, samples))
        assert compute_signature(surface, auto).points.shape == (100, expected)
        assert expected >= 3


def test_a_signature_needs_a_connected_surface():
    lines = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "v 5 0 0", "v 6 0 0", "v 5 3 0", "f 1 2 3", "f 4 5 6"]
    surface = read_mesh("\n".join(lines).encode())
    assert set(compute_signature(surface).samples.tolist()) == {3, 4, 5}
    with pytest.raises(MeshGeometryError, match="not connected"):
        compute_signature(Surface(surface.vertices, [[0, 1, 2], [3, 4, 5]]))


def test_a_surface_without_area_is_refused():
    with pytest.raises(MeshGeometryError, match="area"):
        compute_signature(Surface(np.zeros((3, 3)), [[0, 1, 2]]))


def test_progress_names_the_stages_and_never_decreases():
    seen: list[Progress] = []
    compute_signature(torus(), Parameters(samples=100), progress=seen.append)
    stages = list(dict.fromkeys(progress.stage for progress in seen))
    shares = [progress.share for progress in seen]
    assert stages == ["sampling", "geodesics", "embedding", "describing"]
    assert shares == sorted(shares)
    assert 0 <= shares[0] < shares[-1] <= 1
    assert sum(progress.stage == "geodesics" for progress in seen) > 5


def test_progress_reports_samples_rows_iterations_and_stress():
    seen: list[Progress] = []
    signature = compute_signature(torus(), Parameters(samples=100), progress=seen.append)
    reported = {stage: [progress.detail for progress in seen if progress.stage == stage] for stage in STAGES}
    assert reported["sampling"][0] == {"sample": 0, "samples": 100}
    assert reported["sampling"][-1] == {"sample": 100, "samples": 100}
    assert reported["geodesics"][-1] == {"row": 100, "rows": 100}
    iterations = [detail for detail in reported["embedding"] if detail]
    assert [detail["iteration"] for detail in iterations[:3]] == [1, 2, 3]
    stresses = [detail["stress"] for detail in iterations]
    assert stresses == sorted(stresses, reverse=True)
    assert stresses[-1] == pytest.approx(signature.stress, rel=1e-6)


def test_auto_samples_are_doubled_until_the_spectrum_is_stable():
    surface = ellipsoid((1.0, 0.75, 0.5), subdivisions=4)  # 2562 vertices
    reports: list[Progress] = []
    rough, fine = (
        compute_signature(surface, Parameters(samples="auto", tolerance=tolerance), progress=reports.append)
        for tolerance in (0.05, 0.01)
    )
    assert len(rough.points) < len(fine.points)
    for found, tolerance in ((rough, 0.05), (fine, 0.01)):
        count = len(found.points)
        half = compute_signature(surface, Parameters(samples=count // 2))
        moved = np.abs(found.spectrum - half.spectrum).sum() / np.abs(found.spectrum).sum()
        assert moved <= tolerance
        np.testing.assert_array_equal(found.spectrum, compute_signature(surface, Parameters(samples=count)).spectrum)
    seen = [progress.share for progress in reports]
    halfway = seen.index(max(seen[: len(seen) // 3]))
    assert seen[:halfway] == sorted(seen[:halfway])
    assert max(seen) < 1


def test_auto_samples_are_limited_by_the_number_of_vertices():
    surface = tetrahedron()
    found = compute_signature(surface, Parameters(samples="auto", tolerance=0.001))
    assert len(found.points) == 4
    assert found.parameters.samples == "auto"


def test_the_first_sample_can_be_random_by_seed():
    surface = sphere(subdivisions=3)
    firsts = {
        int(compute_signature(surface, Parameters(samples=20, first_sample="random", seed=seed)).samples[0])
        for seed in range(6)
    }
    assert len(firsts) > 3
    one, again = (
        compute_signature(surface, Parameters(samples=20, first_sample="random", seed=5)).samples for _ in range(2)
    )
    np.testing.assert_array_equal(one, again)


@pytest.mark.parametrize("weights", ["inverse", "inverse_squared", "area"])
def test_named_weights_change_the_points_but_not_the_spectrum(weights):
    surface = torus(columns=24, rows=16)
    plain, weighted = (compute_signature(surface, Parameters(samples=80, weights=rule)) for rule in ("equal", weights))
    assert np.abs(plain.points - weighted.points).max() > 1e-3
    np.testing.assert_array_equal(plain.spectrum, weighted.spectrum)


@pytest.mark.parametrize(
    ("surface", "dimension"),
    [(sheet(columns=30, rows=15), 2), (spiral(columns=30, rows=15), 2), (sheet(columns=60, rows=1, width=8.0), 1)],
)
def test_developable_sheets_have_the_effective_dimension_of_the_plane_or_line(surface, dimension):
    found = compute_signature(surface, Parameters(samples=60))
    assert found.dimension == dimension
    assert found.representation_errors.shape == (6,)
    assert found.representation_errors[dimension - 1] <= 0.05
    assert (np.diff(found.representation_errors) <= 0).all()
    assert compare(found, compute_signature(sphere(3), Parameters(samples=60)), "dimension") > 0.9


def test_signatures_are_read_only():
    signature = compute_signature(tetrahedron())
    with pytest.raises(ValueError, match="read-only"):
        signature.points[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        signature.moments[0] = 0


@pytest.mark.parametrize("file_type", ["ply", "obj", "off", "glb"])
@pytest.mark.parametrize("dimensions", [2, 3, 4])
def test_exported_signatures_can_be_read_as_meshes(file_type, dimensions):
    signature = compute_signature(torus(columns=20, rows=12), Parameters(dimensions=dimensions))
    surface = read_mesh(export_signature(signature, file_type))
    shown = min(3, dimensions)
    np.testing.assert_allclose(surface.vertices[:, :shown], signature.points[:, :shown], atol=1e-6)
    assert len(surface.faces) == len(signature.faces)


def test_json_and_npz_exports_contain_all_fields():
    signature = compute_signature(tetrahedron())
    reported = json.loads(export_signature(signature, "json"))
    with np.load(io.BytesIO(export_signature(signature, "npz"))) as arrays:
        for name in ("points", "faces", "samples", "weights"):
            np.testing.assert_array_equal(reported[name], getattr(signature, name))
            np.testing.assert_array_equal(arrays[name], getattr(signature, name))
        np.testing.assert_array_equal(arrays["moments"], signature.moments)
    assert reported["parameters"] == Parameters().as_dict()
    assert reported["descriptors"]["spectrum"] == signature.spectrum.tolist()


def test_an_unknown_export_format_is_refused():
    with pytest.raises(ParameterError, match="ply"):
        export_signature(compute_signature(tetrahedron()), "step")
