"""Surfaces for viewers: simplified, with canonical forms and the vertices of the file."""

from __future__ import annotations

import numpy as np
import pytest

from unbend import Parameters, compute_signature, read_mesh
from unbend.mesh.shapes import torus
from unbend.mesh.surface import Surface
from unbend.mesh.write import write_mesh
from unbend.render.display import display, simplified_form

FEW = Parameters(samples=40)


def signature_of(surface, **parameters):
    return compute_signature(surface, Parameters(samples=40, **parameters))


def test_a_small_surface_is_displayed_as_it_is():
    surface = torus(columns=20, rows=10)
    shown = display(surface, signature_of(surface))
    assert np.array_equal(shown.faces, surface.faces)
    assert shown.vertices + shown.centre == pytest.approx(surface.vertices)
    assert np.array_equal(shown.numbers, np.arange(len(surface.vertices)))
    assert np.allclose(shown.vertices.min(axis=0), -shown.vertices.max(axis=0))


def test_unused_vertices_are_left_out():
    ring = torus(columns=20, rows=10)
    surface = Surface(np.vstack([[[9.0, 9, 9]], ring.vertices]), ring.faces + 1)
    shown = display(surface, signature_of(surface))
    assert len(shown.vertices) == len(ring.vertices)
    assert np.array_equal(shown.numbers, np.arange(1, len(ring.vertices) + 1))


def test_numbers_are_those_of_the_file_where_seams_were_joined():
    ring = torus(columns=20, rows=10)
    apart = Surface(ring.vertices[ring.faces.ravel()], np.arange(3 * len(ring.faces)).reshape(-1, 3))
    surface = read_mesh(write_mesh(apart.vertices, apart.faces, "off"))
    assert surface.vertex_map is not None
    shown = display(surface, signature_of(surface))
    assert shown.vertices + shown.centre == pytest.approx(apart.vertices[shown.numbers])


@pytest.mark.parametrize("dimensions", [1, 2, 3, 6])
def test_a_form_of_any_dimension_is_displayed(dimensions):
    surface = torus(columns=20, rows=10)
    shown = display(surface, signature_of(surface, dimensions=dimensions))
    assert shown.dimensions == dimensions
    assert shown.form.shape == (len(surface.vertices), max(3, dimensions))
    assert np.isfinite(shown.form).all()
    assert shown.as_glb()[:4] == b"glTF"


def test_a_form_lies_as_its_surface_stands(rotation):
    surface = torus(columns=40, rows=16)
    signature = signature_of(surface)
    plain = display(surface, signature)
    turn = rotation(5)
    turned = display(Surface(surface.vertices @ turn.T, surface.faces), signature)
    apart = np.linalg.norm(plain.form @ turn.T - turned.form, axis=1).max()
    assert apart < 0.01 * np.ptp(plain.form)


def test_simplification_keeps_the_form():
    surface = torus(columns=120, rows=60)
    signature = signature_of(surface)
    full, full_form, _ = simplified_form(surface, signature, 10**6)
    shown, form, chosen = simplified_form(surface, signature, 1500)
    assert len(full.faces) == len(surface.faces)
    assert len(shown.faces) <= 1500
    assert np.array_equal(shown.vertices, surface.vertices[chosen])
    apart = np.linalg.norm(form.points - full_form.points[chosen], axis=1)
    assert apart.mean() < 0.05 * np.ptp(full_form.points)


def test_a_display_is_the_same_on_every_run():
    surface = torus(columns=120, rows=60)
    signature = signature_of(surface)
    assert display(surface, signature, 1500).as_glb() == display(surface, signature, 1500).as_glb()
