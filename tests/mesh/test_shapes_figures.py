"""Articulated figures, and the collection of demo shapes."""

import itertools
from collections import Counter

import numpy as np
import pytest

from unbend.errors import ParameterError
from unbend.mesh.shapes import FIGURES, LabelledShape, demo_shapes, figure
from unbend.mesh.surface import Surface

POSES = range(6)


@pytest.fixture(scope="module")
def figures():
    """The first poses of every kind of figure."""
    return {kind: [figure(kind, pose) for pose in POSES] for kind in FIGURES}


def directed_edges(surface):
    return np.concatenate([surface.faces[:, [k, (k + 1) % 3]] for k in range(3)])


def assert_closed_sphere(surface):
    """Check that a surface is closed and oriented outward, with Euler characteristic 2."""
    directed = directed_edges(surface)
    unique = np.unique(directed, axis=0)
    assert len(unique) == len(directed)
    assert np.array_equal(unique, np.unique(directed[:, ::-1], axis=0))
    assert len(np.unique(surface.faces)) == len(surface.vertices)
    assert len(surface.vertices) - len(directed) // 2 + len(surface.faces) == 2
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


def test_there_are_at_least_five_kinds_of_figures():
    assert len(set(FIGURES)) >= 5


@pytest.mark.parametrize("kind", FIGURES)
def test_every_pose_is_closed_and_oriented_outward(figures, kind):
    for surface in figures[kind]:
        assert_closed_sphere(surface)
        assert 1300 <= len(surface.vertices) <= 3000


@pytest.mark.parametrize("kind", FIGURES)
def test_the_area_of_a_figure_hardly_depends_on_its_pose(figures, kind):
    # In 150 poses of each kind, the areas had a range of 0.5 to 1.6 percent of their mean.
    areas = np.array([surface.area for surface in figures[kind]])
    assert np.ptp(areas) / areas.mean() < 0.025


@pytest.mark.parametrize("kind", FIGURES)
def test_triangles_of_figures_are_well_shaped(figures, kind):
    for surface in figures[kind]:
        corners = surface.vertices[surface.faces]
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        assert surface.face_areas.min() > 0
        # Twice the ratio of the radii of the inscribed and circumscribed circles: 1 for an equilateral triangle.
        quality = 16 * surface.face_areas**2 / (edges.prod(axis=1) * edges.sum(axis=1))
        assert np.percentile(quality, 5) > 0.5


@pytest.mark.parametrize("kind", FIGURES)
def test_poses_of_a_figure_differ(figures, kind):
    # Compare percentiles of the distances from the centroid.
    spreads = []
    for surface in figures[kind]:
        away = np.linalg.norm(surface.vertices - surface.vertices.mean(axis=0), axis=1)
        spreads.append(np.percentile(away, np.arange(5, 100, 5)))
    for first, second in itertools.combinations(spreads, 2):
        assert np.abs(first - second).max() > 0.005


def test_kinds_of_figures_differ_in_compactness(figures):
    def compactness(surface):
        a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
        return np.einsum("ij,ij->", a, np.cross(b, c)) / 6 / surface.area**1.5

    shares = sorted(np.mean([compactness(surface) for surface in figures[kind]]) for kind in FIGURES)
    assert (np.diff(shares) / shares[1:]).min() > 0.02


def test_figures_are_deterministic():
    first, second = figure("biped", 7), figure("biped", 7)
    assert np.array_equal(first.vertices, second.vertices)
    assert np.array_equal(first.faces, second.faces)


def test_another_seed_gives_other_poses():
    assert not np.array_equal(figure("hand", 3).vertices, figure("hand", 3, seed=1).vertices)


def test_the_scale_of_a_figure_multiplies_its_coordinates():
    assert np.array_equal(figure("bird", scale=3.0).vertices, 3.0 * figure("bird").vertices)


@pytest.mark.parametrize("kind", ["biped", "spider"])
def test_a_higher_resolution_refines_the_same_pose(kind):
    coarse, fine = figure(kind, 2), figure(kind, 2, resolution=6000)
    assert_closed_sphere(fine)
    assert 2.5 < len(fine.vertices) / len(coarse.vertices) < 3.5
    assert fine.area == pytest.approx(coarse.area, rel=0.03)
    assert np.ptp(fine.vertices, axis=0) == pytest.approx(np.ptp(coarse.vertices, axis=0), rel=0.03)


@pytest.mark.parametrize(
    "arguments",
    [
        {"kind": "unicorn"},
        {"kind": "biped", "pose": -1},
        {"kind": "biped", "pose": 1.5},
        {"kind": "biped", "resolution": 10},
        {"kind": "biped", "scale": 0.0},
        {"kind": "biped", "seed": -1},
    ],
)
def test_invalid_parameters_of_figures_are_refused(arguments):
    with pytest.raises(ParameterError):
        figure(**arguments)


def test_the_demo_collection_has_ten_classes_of_six():
    names, labels = [], Counter()
    for shape in demo_shapes():
        assert isinstance(shape, LabelledShape)
        assert isinstance(shape.surface, Surface)
        assert 500 <= len(shape.surface.vertices) <= 2500
        assert shape.name.startswith(f"{shape.label}-")
        names.append(shape.name)
        labels[shape.label] += 1
    assert len(set(names)) == len(names)
    assert len(labels) >= 10
    assert min(labels.values()) >= 6
    assert set(FIGURES) < set(labels)


def test_the_demo_collection_is_deterministic():
    first, second = (list(itertools.islice(demo_shapes(), 8)) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert one.name == other.name
        assert np.array_equal(one.surface.vertices, other.surface.vertices)


def test_the_classes_of_the_demo_collection_keep_their_area():
    shapes = itertools.islice(demo_shapes(), 30)
    for label, members in itertools.groupby(shapes, key=lambda shape: shape.label):
        areas = np.array([shape.surface.area for shape in members])
        assert np.ptp(areas) / areas.mean() < 0.01, label
