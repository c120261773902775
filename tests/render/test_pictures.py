"""Pictures as files: their format and size, what they show and where, and requests that are refused."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from PIL import Image

from unbend import CanonicalForm, Parameters, Surface, canonical_form
from unbend.errors import ParameterError, UnsuitedError
from unbend.mesh.shapes import cylinder, figure, sheet, sphere, torus
from unbend.render.carry import carry
from unbend.render.colours import THEMES, colour_table, to_linear
from unbend.render.picture import form_in_space, render_picture, render_pixels
from unbend.render.request import PictureRequest
from unbend.render.upright import upright_axis
from unbend.render.view import fit_camera, view_axes

FLAT = sheet(columns=24, rows=12)
ROLLED = cylinder(columns=24, rows=12)
FRONT = PictureRequest(width=300, height=200, theme="transparent", azimuth=0, elevation=0, up="y")


@cache
def form_of(dimensions=3):
    return canonical_form(ROLLED, Parameters(samples=40, dimensions=dimensions))


def opened(data: bytes) -> Image.Image:
    return Image.open(io.BytesIO(data))


def hue(pixels):
    linear = to_linear(np.asarray(pixels)[..., :3] / 255)
    return linear / np.linalg.norm(linear, axis=-1, keepdims=True)


def covered(pixels) -> tuple[int, int]:
    """Width and height of what is not transparent."""
    rows, columns = np.nonzero(pixels[..., 3] > 128)
    return int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1


@pytest.mark.parametrize("file_type", ["png", "webp"])
@pytest.mark.parametrize("theme", ["light", "dark", "transparent"])
def test_a_file_has_the_format_and_size_of_its_request(file_type, theme):
    request = PictureRequest(width=90, height=64, format=file_type, theme=theme)
    image = opened(render_picture(request, torus(columns=20, rows=12)))
    assert (image.format, image.size) == (file_type.upper(), (90, 64))
    assert image.mode == ("RGBA" if theme == "transparent" else "RGB")
    corner = image.getpixel((0, 0))
    if theme == "transparent":
        assert corner[3] == 0
    else:
        np.testing.assert_allclose(corner, np.array(THEMES[theme].background) * 255, atol=2)


@pytest.mark.parametrize("file_type", ["png", "webp"])
def test_the_same_request_gives_the_same_bytes(file_type):
    request = PictureRequest(width=120, height=90, format=file_type, subject="both", distances_from=3, contours=True)
    surface = Surface(ROLLED.vertices, ROLLED.faces)  # which has computed nothing yet
    assert render_picture(request, surface, form_of(), threads=1) == render_picture(request, ROLLED, form_of())


def test_a_signature_stands_beside_its_surface_at_the_same_scale():
    form = canonical_form(FLAT, Parameters(samples=60, dimensions=2))
    both = render_pixels(replace(FRONT, width=600, subject="both"), FLAT, form)
    columns = np.flatnonzero((both[..., 3] > 128).any(axis=0))
    (gap,) = np.flatnonzero(np.diff(columns) > 1)
    middle = (columns[gap] + columns[gap + 1]) // 2
    left, right = both[:, :middle], both[:, middle:]
    np.testing.assert_allclose(covered(left), covered(right), atol=4)
    light = THEMES["transparent"]
    for half, colour in ((left, light.surface), (right, light.signature)):
        inside = half[half[..., 3] == 255]
        np.testing.assert_allclose(hue(inside).mean(axis=0), hue(np.array(colour) * 255), atol=0.05)


def test_a_signature_lies_as_its_surface_stands(rotation):
    body = figure("quadruped", 1)
    form = canonical_form(body, Parameters(samples=100))
    request = PictureRequest(width=160, height=160, theme="transparent", subject="signature", up="z")
    expected = render_pixels(request, body, form).astype(int)
    turned = CanonicalForm(form.points @ rotation(5), form.faces, form.signature)
    assert np.abs(render_pixels(request, body, turned) - expected).mean() < 0.1
    np.testing.assert_allclose(form_in_space(turned, body), form_in_space(form, body), atol=1e-9)


def test_distances_have_the_colours_of_their_values():
    corner = int((FLAT.vertices @ [1.0, 1.0, 0.0]).argmin())
    pixels = render_pixels(replace(FRONT, distances_from=corner), FLAT)
    camera = fit_camera(FLAT.vertices, view_axes(0, 0, "y"), (300, 200))
    distances = np.linalg.norm(FLAT.vertices - FLAT.vertices[corner], axis=1)
    inside = ((FLAT.vertices[:, :2] > 0.1) & (FLAT.vertices[:, :2] < [1.9, 0.9])).all(axis=1) & (distances > 0.2)
    columns, rows = camera.pixels(FLAT.vertices[inside], (300, 200)).astype(int).T
    table = hue(colour_table("viridis") * 255)
    entries = np.linalg.norm(hue(pixels[rows, columns])[:, None] - table, axis=2).argmin(axis=1)
    np.testing.assert_allclose(entries, distances[inside] / distances.max() * 255, atol=20)


def test_contours_are_as_far_apart_as_the_distances_say():
    edge = int(np.abs(FLAT.vertices - FLAT.vertices.min(axis=0)).sum(axis=1).argmin())
    plain = render_pixels(replace(FRONT, distances_from=edge), FLAT).astype(int)
    lined = render_pixels(replace(FRONT, distances_from=edge, contours=True), FLAT).astype(int)
    camera = fit_camera(FLAT.vertices, view_axes(0, 0, "y"), (300, 200))
    most = np.linalg.norm(FLAT.vertices - FLAT.vertices[edge], axis=1).max()
    along = np.linspace(0.15, 1.9, 800)[:, None] * [0.9, 0.4, 0.0]
    places = camera.pixels(FLAT.vertices[edge] + along, (300, 200)).astype(int)
    darker = (plain - lined)[places[:, 1], places[:, 0], :3].sum(axis=1) > 60
    number = np.linalg.norm(along, axis=1) / most * 16
    found = np.unique(np.round(number[darker]))
    np.testing.assert_array_equal(found, np.arange(found[0], found[-1] + 1))
    assert len(found) > 10
    assert np.abs(number[darker] - np.round(number[darker])).max() < 0.2


def test_a_path_is_drawn_from_end_to_end():
    corners = [int((FLAT.vertices @ [x, y, 0.0]).argmin()) for x, y in ((1, 1), (-1, -1))]
    pixels = render_pixels(replace(FRONT, path=tuple(corners)), FLAT)
    camera = fit_camera(FLAT.vertices, view_axes(0, 0, "y"), (300, 200))
    ends = FLAT.vertices[corners]
    line = ends[0] + np.linspace(0.05, 0.95, 50)[:, None] * (ends[1] - ends[0])
    places = camera.pixels(line, (300, 200)).astype(int)
    np.testing.assert_allclose(hue(pixels[places[:, 1], places[:, 0]])[:, 0].min(), 1.0, atol=0.15)  # red
    red = (hue(np.maximum(pixels, 1))[..., 0] > 0.8) & (pixels[..., 3] == 255)
    assert 50 < red.sum() < 0.05 * (pixels[..., 3] == 255).sum()


def test_a_path_on_a_form_joins_the_same_vertices():
    body = torus(columns=40, rows=20)
    some = np.random.default_rng(0).integers(len(body.faces), size=50)
    shares = np.random.default_rng(1).dirichlet(np.ones(3), 50)
    points = (shares[..., None] * body.vertices[body.faces[some]]).sum(axis=1)
    form = body.vertices[:, ::-1] * 2 + np.sin(body.vertices)
    there = (shares[..., None] * form[body.faces[some]]).sum(axis=1)
    np.testing.assert_allclose(carry(body.vertices, body.faces, points, form), there, atol=1e-9)
    np.testing.assert_allclose(carry(body.vertices, body.faces, body.vertices, form), form, atol=1e-9)


def test_a_further_dimension_is_shown_by_colours():
    request = PictureRequest(width=160, height=160, theme="transparent", dimension=4)
    shown = render_pixels(request, ROLLED, form_of(5))
    plain = render_pixels(replace(request, dimension=None), ROLLED)
    np.testing.assert_array_equal(shown[..., 3], plain[..., 3])
    assert np.ptp(hue(shown[shown[..., 3] == 255])[:, 0]) > 0.3


def test_the_upright_axis_is_found():
    for kind in ("biped", "quadruped", "hand"):
        body = figure(kind, 3)
        assert upright_axis(body) == "z"
        assert upright_axis(Surface(body.vertices[:, [1, 2, 0]], body.faces)) == "y"
    assert upright_axis(sphere()) in ("y", "z")
    assert upright_axis(FLAT) in ("y", "z")
    assert upright_axis(Surface(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]))) == "y"


def test_vertices_without_a_face_do_not_show():
    alone = Surface(np.vstack([FLAT.vertices, [[99.0, 99.0, np.nan]]]), FLAT.faces)
    request = replace(FRONT, distances_from=5, path=(5, 90))
    np.testing.assert_array_equal(render_pixels(request, alone), render_pixels(request, FLAT))
    with pytest.raises(UnsuitedError, match="no face uses vertex"):
        render_pixels(replace(FRONT, distances_from=len(FLAT.vertices)), alone)


@pytest.mark.parametrize("exponent", [460, -460])
def test_the_unit_of_length_does_not_matter(exponent):
    request = replace(FRONT, distances_from=5, path=(5, 90), contours=True)
    scaled = Surface(np.ldexp(FLAT.vertices, exponent), FLAT.faces)
    np.testing.assert_array_equal(render_pixels(request, scaled), render_pixels(request, FLAT))


def test_a_surface_without_an_area_is_drawn_as_nothing():
    line = Surface(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]))
    point = Surface(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    for surface in (line, point):
        assert render_pixels(FRONT, surface)[..., 3].max() == 0


def test_unreachable_parts_have_the_colour_of_the_unknown():
    moved = FLAT.vertices + np.array([3 * np.ptp(FLAT.vertices[:, 0]), 0, 0])
    two = Surface(np.vstack([FLAT.vertices, moved]), np.vstack([FLAT.faces, FLAT.faces + len(FLAT.vertices)]))
    pixels = render_pixels(replace(FRONT, distances_from=5, contours=True), two)
    right = pixels[:, 200:][pixels[:, 200:, 3] == 255]
    np.testing.assert_allclose(hue(right).mean(axis=0), hue(np.array(THEMES["light"].unknown) * 255), atol=0.05)
    with pytest.raises(UnsuitedError, match="no path leads"):
        render_pixels(replace(FRONT, path=(0, len(two.vertices) - 1)), two)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"width": 15}, "width must be"),
        ({"height": 2049}, "height must be"),
        ({"width": True}, "width must be"),
        ({"width": "64"}, "width must be"),
        ({"format": "gif"}, "format must be one of png, webp"),
        ({"subject": "object"}, "subject must be one of"),
        ({"theme": "blue"}, "theme must be one of"),
        ({"up": "w"}, "up must be one of"),
        ({"azimuth": float("nan")}, "azimuth must be"),
        ({"azimuth": 361}, "azimuth must be"),
        ({"elevation": -91}, "elevation must be"),
        ({"elevation": "low"}, "elevation must be"),
        ({"distances_from": -1}, "distances_from must be"),
        ({"distances_from": 1.5}, "distances_from must be"),
        ({"dimension": 3}, "dimension must be"),
        ({"dimension": 7}, "dimension must be"),
        ({"dimension": 4, "distances_from": 0}, "not both"),
        ({"contours": True}, "contours go with"),
        ({"contours": 1, "dimension": 4}, "contours must be"),
        ({"path": (1,)}, "path must be"),
        ({"path": (1, -2)}, "path must be"),
        ({"path": 7}, "path must be"),
        ({"colour": "red"}, "unknown field 'colour'"),
    ],
)
def test_a_bad_request_is_refused(values, words):
    with pytest.raises(ParameterError, match=words):
        PictureRequest.from_dict(values)


@pytest.mark.parametrize(
    ("values", "form", "error", "words"),
    [
        ({"subject": "both"}, None, ParameterError, "needs the canonical form"),
        ({"dimension": 4}, None, ParameterError, "needs the canonical form"),
        ({"dimension": 4}, 3, UnsuitedError, "no dimension 4"),
        ({"distances_from": 10**6}, None, ParameterError, "no vertex 1000000"),
        ({"path": (0, 10**6)}, None, ParameterError, "no vertex 1000000"),
    ],
)
def test_a_request_that_the_surface_does_not_allow_is_refused(values, form, error, words):
    with pytest.raises(error, match=words):
        render_picture(PictureRequest(**values), ROLLED, form and form_of(form))


def test_the_form_of_another_surface_is_refused():
    with pytest.raises(ParameterError, match="another surface"):
        render_picture(PictureRequest(subject="signature"), torus(), form_of())


def test_a_request_survives_json():
    request = PictureRequest(width=100, path=(3, 4), azimuth=10.0, distances_from=2, contours=True)
    assert PictureRequest.from_json(request.to_json()) == request
    assert hash(request) == hash(PictureRequest.from_json(request.to_json()))
