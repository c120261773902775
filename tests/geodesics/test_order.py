"""Distances do not depend on the representation: order of faces, first corners, orientation, numbering."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.oracles import grid
from unbend import Surface, farthest_point_sampling, geodesic_distances, read_mesh
from unbend.mesh.shapes import sphere, torus

SINGLE_PRECISION = 1e-6
"""Bound of accumulated rounding: distances are computed in single precision, which rounds by up to 6e-8."""


def crumpled(rng: np.random.Generator) -> Surface:
    flat = grid(9, 7)
    return Surface(flat.vertices + rng.normal(0, 0.2, flat.vertices.shape), flat.faces)


def stretched(rng: np.random.Generator) -> Surface:
    """Return a crumpled sheet stretched by 12, so that its thin triangles are flipped and refined."""
    sheet = crumpled(rng)
    return Surface(sheet.vertices * [12.0, 1.0, 1.0], sheet.faces)


def book(rng: np.random.Generator) -> Surface:
    """Return three crumpled sheets with a common side, whose edges have three faces each."""
    pages, flat = [], grid(4, 6)
    back = np.flatnonzero(flat.vertices[:, 0] == 0)
    inner = np.flatnonzero(flat.vertices[:, 0] > 0)
    vertices = [flat.vertices[back]]
    for page, angle in enumerate([0.0, 2.0, 4.0]):
        x, y = flat.vertices[inner, 0], flat.vertices[inner, 1]
        turned = np.stack([x * np.cos(angle), y, x * np.sin(angle)], 1)
        vertices.append(turned + rng.normal(0, 0.1, turned.shape))
        place = np.empty(len(flat.vertices), int)
        place[back] = np.arange(len(back))
        place[inner] = len(back) + page * len(inner) + np.arange(len(inner))
        pages.append(place[flat.faces])
    return Surface(np.concatenate(vertices), np.concatenate(pages))


def moebius_band(rng: np.random.Generator) -> Surface:
    """Return a Möbius band, whose faces cannot all have the same orientation."""
    columns, rows = 24, 3
    around, across = np.meshgrid(np.arange(columns), np.arange(rows + 1), indexing="ij")
    t, w = 2 * np.pi * around / columns, across / rows - 0.5
    r = 1 + w * np.cos(t / 2)
    vertices = np.stack([r * np.cos(t), r * np.sin(t), w * np.sin(t / 2)], -1).reshape(-1, 3)
    faces = []
    for i in range(columns):
        for j in range(rows):
            a, b = i * (rows + 1) + j, i * (rows + 1) + j + 1
            last = i + 1 == columns
            c, d = (rows - j, rows - j - 1) if last else (a + rows + 1, b + rows + 1)
            faces += [[a, c, b], [b, c, d]]
    return Surface(vertices + rng.normal(0, 0.02, vertices.shape), np.array(faces))


def two_parts(rng: np.random.Generator) -> Surface:
    one, other = crumpled(rng), sphere(subdivisions=1)
    return Surface(
        np.concatenate([one.vertices, other.vertices + 20]),
        np.concatenate([one.faces, other.faces + len(one.vertices)]),
    )


def regular(_: np.random.Generator) -> Surface:
    """Return a regular grid on a torus, with many equal distances."""
    return torus(columns=20, rows=12)


SHAPES = {f.__name__: f for f in (crumpled, stretched, book, moebius_band, two_parts, regular)}


def reordered(surface: Surface, rng: np.random.Generator) -> Surface:
    return Surface(surface.vertices, rng.permutation(surface.faces))


def rolled(surface: Surface, rng: np.random.Generator) -> Surface:
    first = rng.integers(0, 3, (len(surface.faces), 1))
    return Surface(surface.vertices, np.take_along_axis(surface.faces, (first + np.arange(3)) % 3, axis=1))


def reversed_(surface: Surface, rng: np.random.Generator) -> Surface:
    return Surface(surface.vertices, surface.faces[:, ::-1])


def some_reversed(surface: Surface, rng: np.random.Generator) -> Surface:
    faces = surface.faces.copy()
    some = rng.random(len(faces)) < 0.5
    faces[some] = faces[some, ::-1]
    return Surface(surface.vertices, faces)


REWRITES = {f.__name__.strip("_"): f for f in (reordered, rolled, reversed_, some_reversed)}


@pytest.mark.parametrize("update", ["spherical", "planar"])
@given(st.sampled_from(sorted(SHAPES)), st.sampled_from(sorted(REWRITES)), st.integers(0, 2**32 - 1))
def test_distances_do_not_depend_on_how_faces_are_written(update, shape, rewrite, seed):
    rng = np.random.default_rng(seed)
    surface = SHAPES[shape](rng)
    sources = rng.integers(0, len(surface.vertices), 3)
    again = REWRITES[rewrite](surface, rng)
    np.testing.assert_allclose(
        geodesic_distances(again, sources, update=update), geodesic_distances(surface, sources, update=update),
        rtol=SINGLE_PRECISION,
    )  # fmt: skip


@given(st.sampled_from(sorted(set(SHAPES) - {"regular"})), st.integers(0, 2**32 - 1))
def test_distances_do_not_depend_on_the_numbering_of_vertices(shape, seed):
    """The regular grid is excluded, because the numbering decides between equal distances."""
    rng = np.random.default_rng(seed)
    surface = SHAPES[shape](rng)
    order = rng.permutation(len(surface.vertices))
    place = np.argsort(order)
    again = reordered(Surface(surface.vertices[order], place[surface.faces]), rng)
    sources = rng.integers(0, len(order), 3)
    np.testing.assert_allclose(
        geodesic_distances(again, place[sources])[:, place], geodesic_distances(surface, sources), rtol=SINGLE_PRECISION
    )


@given(st.sampled_from(sorted(SHAPES)), st.sampled_from(sorted(REWRITES)), st.integers(0, 2**32 - 1))
def test_samples_do_not_depend_on_how_faces_are_written(shape, rewrite, seed):
    rng = np.random.default_rng(seed)
    surface = SHAPES[shape](rng)
    again = REWRITES[rewrite](surface, rng)
    np.testing.assert_array_equal(farthest_point_sampling(again, 20), farthest_point_sampling(surface, 20))


@pytest.mark.parametrize("update", ["spherical", "planar"])
@pytest.mark.parametrize("name", ["tosca5k/cat0.off", "tosca5k/centaur1.off", "dirty/cow.obj"])
def test_distances_on_real_meshes_do_not_depend_on_how_faces_are_written(shared_data, name, update):
    surface, rng = read_mesh(shared_data / name), np.random.default_rng(0)
    sources = rng.choice(surface.used_vertices, 4)
    distances = geodesic_distances(surface, sources, update=update)
    for rewrite in REWRITES.values():
        again = geodesic_distances(rewrite(surface, rng), sources, update=update)
        np.testing.assert_allclose(again, distances, rtol=SINGLE_PRECISION)
