"""Farthest point sampling."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.oracles import grid
from unbend import Surface, farthest_point_sampling, geodesic_distances, read_mesh
from unbend.errors import ParameterError
from unbend.geodesics.sampling import sample_farthest
from unbend.geodesics.stencils import stencils_of
from unbend.mesh.shapes import sphere, torus
from unbend.tolerances import SAMPLING_TIE

FARTHEST = 1 - SAMPLING_TIE - 1e-6


def shares_of_the_farthest(surface: Surface, samples: np.ndarray) -> np.ndarray:
    """Return each later sample's distance from the previous samples, as a share of the farthest vertex's distance."""
    nearest = np.minimum.accumulate(geodesic_distances(surface, samples)[:, surface.used_vertices])
    place = np.searchsorted(surface.used_vertices, samples)
    farthest = np.where(np.isfinite(nearest), nearest, 0).max(axis=1)
    return nearest[np.arange(len(samples) - 1), place[1:]] / farthest[:-1]


def crumpled(seed: int) -> Surface:
    flat = grid(14, 11)
    return Surface(flat.vertices + np.random.default_rng(seed).normal(0, 0.2, flat.vertices.shape), flat.faces)


@pytest.mark.parametrize("surface", [torus(columns=24, rows=16), sphere(subdivisions=3), *map(crumpled, range(5))])
def test_each_sample_is_the_farthest_from_the_previous_ones_up_to_ties(surface):
    samples = farthest_point_sampling(surface, 60, start=5)
    assert samples[0] == 5
    assert shares_of_the_farthest(surface, samples).min() > FARTHEST


@pytest.mark.parametrize(
    "name", ["shrec11_simplified/T485.obj", "shrec11_simplified/T570.obj", "tosca5k/cat7.off", "faust5k/tr_reg_003.off"]
)
def test_each_sample_is_the_farthest_on_real_meshes(shared_data, name):
    surface = read_mesh(shared_data / name)
    assert shares_of_the_farthest(surface, farthest_point_sampling(surface, 100)).min() > FARTHEST


def test_each_vertex_is_in_the_cell_of_its_nearest_sample():
    surface = sphere(subdivisions=3)
    sampling = sample_farthest(surface, stencils_of(surface), 12)
    rows = geodesic_distances(surface, sampling.samples)
    chosen = rows[sampling.nearest, np.arange(len(surface.vertices))]
    assert (chosen <= rows.min(axis=0) * 1.02 + 1e-12).all()
    assert sampling.radius == pytest.approx(rows.min(axis=0).max(), rel=0.02)
    np.testing.assert_array_equal(sampling.nearest[sampling.samples], np.arange(12))


def test_sampling_all_vertices_takes_each_once():
    surface = sphere(subdivisions=1)
    samples = farthest_point_sampling(surface, len(surface.vertices))
    np.testing.assert_array_equal(np.sort(samples), np.arange(len(surface.vertices)))


def test_the_default_start_is_deterministic_and_at_an_end_of_the_surface():
    surface = grid(30, 3)
    corners = {0, 30, 3 * 31, 4 * 31 - 1}
    first = farthest_point_sampling(surface, 2)
    assert set(first.tolist()) <= corners
    np.testing.assert_array_equal(first, farthest_point_sampling(surface, 2))


def test_vertices_without_faces_are_never_chosen():
    flat = grid(3, 3)
    surface = Surface([*flat.vertices, [99, 99, 99]], flat.faces)
    assert 16 not in farthest_point_sampling(surface, 16)


@pytest.mark.parametrize(("count", "start"), [(0, None), (17, None), (3, 16), (3, -1)])
def test_wrong_arguments_are_refused(count, start):
    with pytest.raises(ParameterError):
        farthest_point_sampling(grid(3, 3), count, start=start)
