"""Roughness: noisy surfaces are reported as rough, clean ones are not."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.defects import defective
from unbend import MeshPolicy, Surface, read_mesh
from unbend.errors import MeshError
from unbend.mesh.repair import repair
from unbend.mesh.roughness import ROUGH, roughness
from unbend.mesh.shapes import bent_tube, cone, figure, helicoid_catenoid, sheet, sphere, torus

WORDS = "the surface is rough"


def with_noise(surface, edges, seed=0):
    """Add Gaussian noise whose standard deviation is `edges` times the median edge length."""
    corners = surface.vertices[surface.faces]
    median = np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2))
    noise = np.random.default_rng(seed).normal(size=surface.vertices.shape)
    return Surface(surface.vertices + edges * median * noise, surface.faces)


def plain_roughness(surface):
    """Compute the roughness by loops over neighbours, as the definition says; boundary vertices do not count."""
    vertices, faces = surface.vertices, surface.faces
    near = [set() for _ in vertices]
    sides: dict[frozenset[int], int] = {}
    normals = np.zeros_like(vertices)
    for face in faces.tolist():
        normal = np.cross(vertices[face[1]] - vertices[face[0]], vertices[face[2]] - vertices[face[0]])
        for corner in face:
            near[corner] |= set(face) - {corner}
            normals[corner] += normal
            side = frozenset(face) - {corner}
            sides[side] = sides.get(side, 0) + 1
    rim = set().union(*(side for side, count in sides.items() if count == 1))

    def towards(points):
        return np.array(
            [
                np.zeros(3) if not some or own in rim else points[sorted(some)].mean(axis=0) - points[own]
                for own, some in enumerate(near)
            ]
        )

    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    bending = (towards(vertices) * normals).sum(axis=1)
    around = np.array([bending[sorted(some)].sum() for some in near])
    against = abs(bending)[bending * around < 0].sum() / abs(bending).sum()
    points = vertices + 0.5 * towards(vertices)
    points = points - 0.53 * towards(points)
    return against * max(0.0, 1 - Surface(points, faces).area / surface.area)


@given(st.sampled_from(["ball", "ring", "sheet"]), st.floats(0.05, 1), st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_roughness_equals_a_plain_implementation_of_its_definition(name, edges, seed):
    base = {"ball": sphere(2), "ring": torus(columns=14, rows=9), "sheet": sheet(columns=9, rows=7)}[name]
    surface = with_noise(base, edges, seed)
    assert roughness(surface) == pytest.approx(plain_roughness(surface), rel=1e-9)


@pytest.mark.parametrize(
    "surface",
    [sphere(3), torus(), sheet(), cone(), helicoid_catenoid(0.5), bent_tube("helix"), figure("bird", seed=0)],
    ids=["ball", "ring", "sheet", "cone", "helicoid", "tube", "bird"],
)
def test_shapes_are_reported_as_rough_only_with_noise(surface):
    report = repair(surface.vertices, surface.faces).report
    assert report.roughness < ROUGH / 10
    assert not any(WORDS in note for note in report.notes)
    noise = with_noise(surface, 0.3)
    report = repair(noise.vertices, noise.faces).report
    assert report.roughness > 1.5 * ROUGH
    assert sum(WORDS in note and "`smooth`" in note for note in report.notes) == 1


@pytest.mark.parametrize("surface", [sheet(), cone(), sphere(0), sphere(1)], ids=["sheet", "cone", "solid", "coarse"])
def test_flat_and_evenly_bent_surfaces_have_no_roughness(surface):
    assert roughness(surface) < 1e-9


def test_tiny_noise_on_a_flat_surface_is_not_rough():
    flat = sheet(columns=30, rows=20)
    assert roughness(with_noise(flat, 1e-9)) < 1e-15
    assert roughness(with_noise(flat, 0.01)) < ROUGH / 10


def test_roughness_does_not_depend_on_position_scale_or_order(rotation):
    body = with_noise(figure("biped", seed=0), 0.2)
    expected = roughness(body)
    order = np.random.default_rng(1).permutation(len(body.vertices))
    faces = np.argsort(order)[body.faces][::-1, [1, 2, 0]]
    for scale, offset in ((1.0, 0.0), (-(2.0**400), 0.0), (2.0**-400, 0.0), (3.0, 1e4)):
        moved = scale * (body.vertices @ rotation(0).T)[order] + offset
        assert roughness(Surface(moved, faces)) == pytest.approx(expected, rel=1e-6)


def test_roughness_is_measured_before_smoothing_and_then_not_reported():
    noise = with_noise(sphere(3), 0.3)
    plain = repair(noise.vertices, noise.faces).report
    found = repair(noise.vertices, noise.faces, policy=MeshPolicy(smooth=20))
    assert found.report.roughness == plain.roughness > ROUGH
    assert not any(WORDS in note for note in found.report.notes)
    assert roughness(found) < ROUGH / 2


@given(defective())
def test_roughness_is_between_0_and_1_for_every_damaged_mesh(mesh):
    try:
        report = repair(mesh.vertices, mesh.faces).report
    except MeshError:
        return
    assert 0 <= report.roughness <= 1


@pytest.mark.parametrize(("dataset", "step"), [("tosca5k", 13), ("shrec07", 29), ("faust5k", 15)])
def test_real_meshes_are_rough_only_with_noise(labelled, dataset, step):
    for path, _ in labelled(dataset)[::step]:
        surface = read_mesh(path)
        assert surface.report.roughness < ROUGH / 2, path
        noise = with_noise(surface, 0.4)
        assert roughness(noise) > 2 * ROUGH, path


def test_coarse_real_meshes_are_not_reported_as_rough(shared_data):
    with (shared_data / "labels.csv").open(newline="") as file:
        paths = [row["path"] for row in csv.DictReader(file) if row["dataset"] in {"single", "dirty"}]
    small = [path for path in paths if (shared_data / path).stat().st_size < 200_000]
    assert len(small) > 5
    for path in small:
        assert not any(WORDS in note for note in read_mesh(shared_data / path).report.notes), path
