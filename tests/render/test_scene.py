"""The renderer on shapes whose pictures are known: what covers what, where, and in which colour."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.errors import MeshGeometryError, ParameterError
from unbend.mesh.shapes import figure, sheet, sphere, torus
from unbend.render.colours import THEMES, colour_table, to_linear, to_srgb
from unbend.render.draw import render_scene
from unbend.render.scene import Field, Scene, SceneMesh, Sphere, Tube
from unbend.render.view import MARGIN, Camera, fit_camera, view_axes

RED, BLUE = (0.8, 0.1, 0.1), (0.1, 0.1, 0.8)
CLEAR = THEMES["transparent"]
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def drawn(*items, size=(200, 200), span=2.0, distance=np.inf, theme=CLEAR, threads=None):
    """Return the pixels of a view along -z, by default 100 for a unit of length, with values from 0 to 1."""
    camera = Camera(np.eye(3), np.zeros(3), span, distance)
    return render_scene(Scene(items), camera, size, theme, threads=threads) / 255


def square(left=-0.5, right=0.5, low=-0.5, high=0.5, depth=0.0, slope=0.0, **looks):
    corners = [[x, y, depth + slope * x] for x, y in ((left, low), (right, low), (right, high), (left, high))]
    return SceneMesh(np.array(corners, float), SQUARE, **looks)


def hue(pixels):
    """Linear colours without their brightness."""
    linear = to_linear(np.asarray(pixels)[..., :3])
    return linear / np.linalg.norm(linear, axis=-1, keepdims=True)


def test_a_sphere_covers_the_area_of_its_disc():
    ball = sphere(subdivisions=6)
    pixels = drawn(SceneMesh(ball.vertices, ball.faces), size=(300, 300), span=3.0)
    assert pixels[..., 3].sum() == pytest.approx(np.pi * 100**2, rel=1e-3)
    assert (pixels[85:215, 85:215, 3] == 1).all()  # no sample falls between two faces
    assert pixels[..., 3].argmax(axis=1)[150] == pytest.approx(50, abs=1)


def test_a_near_eye_sees_the_disc_of_its_tangents():
    ball = sphere(subdivisions=6)
    pixels = drawn(SceneMesh(ball.vertices, ball.faces), size=(300, 300), span=3.0, distance=3.0)
    radius = 3.0 / np.sqrt(3.0**2 - 1)
    assert pixels[..., 3].sum() == pytest.approx(np.pi * (100 * radius) ** 2, rel=1e-3)


@pytest.mark.parametrize("distance", [np.inf, 4.0])
def test_the_nearer_part_of_two_crossing_planes_is_seen(distance):
    pixels = drawn(square(slope=1.0, colour=RED), square(slope=-1.0, colour=BLUE), distance=distance)
    rows = pixels[90:110]
    assert (rows[:, 105:140, 0] > rows[:, 105:140, 2]).all()
    assert (rows[:, 60:95, 0] < rows[:, 60:95, 2]).all()


def test_the_order_of_items_does_not_matter():
    items = square(depth=0.2, colour=RED), square(right=0.8, colour=BLUE), Sphere((0.0, 0.0, 0.3), 0.2, (1, 1, 1))
    np.testing.assert_array_equal(drawn(*items), drawn(*items[::-1]))


def test_edges_are_smooth_and_areas_exact():
    triangle = SceneMesh(np.array([[-0.71, -0.53, 0], [0.83, -0.22, 0], [-0.1, 0.77, 0]]), [[0, 1, 2]])
    alpha = drawn(triangle)[..., 3]
    a, b = triangle.vertices[1] - triangle.vertices[0], triangle.vertices[2] - triangle.vertices[0]
    assert alpha.sum() == pytest.approx(abs(a[0] * b[1] - a[1] * b[0]) / 2 * 1e4, rel=2e-3)
    between = alpha[(alpha > 0) & (alpha < 1)]
    assert len(between) > 300
    assert len(np.unique(between)) == 8  # the shares from 1/9 to 8/9 of nine samples


def test_pixels_lie_where_the_camera_says():
    camera = Camera(view_axes(40, 20, "y"), np.array([0.1, 0.2, -0.1]), 3.0, 7.0)
    place = np.array([[0.5, -0.3, 0.4]])
    dot = Sphere(tuple(place[0]), 0.02, RED)
    alpha = render_scene(Scene((dot,)), camera, (320, 200), CLEAR)[..., 3].astype(float)
    rows, columns = np.indices(alpha.shape)
    middle = [(columns * alpha).sum() / alpha.sum() + 0.5, (rows * alpha).sum() / alpha.sum() + 0.5]
    np.testing.assert_allclose(middle, camera.pixels(place, (320, 200))[0], atol=0.1)


@pytest.mark.parametrize("colour_map", ["viridis", "coolwarm"])
def test_a_field_has_the_colours_of_its_map(colour_map):
    flat = sheet(columns=20, rows=20)
    vertices = flat.vertices - flat.vertices.mean(axis=0)
    vertices /= np.ptp(vertices[:, 0])
    mesh = SceneMesh(vertices, flat.faces, field=Field(vertices[:, 0], colour_map, low=-0.5, high=0.5))
    row = drawn(mesh)[100]
    for column in range(55, 146, 10):
        wanted = colour_table(colour_map)[round((column + 0.5 - 50) / 100 * 255)]
        np.testing.assert_allclose(hue(row[column]), hue(wanted), atol=0.08)


def test_contours_lie_where_the_field_has_their_values():
    def row(contours):
        field = Field(np.array([-0.5, 0.5, 0.5, -0.5]), low=-0.5, high=0.5, contours=contours)
        return drawn(square(field=field))[100, :, :3].sum(axis=1)

    darker = row(0) - row(4)
    lines = np.flatnonzero(darker > 0.1)
    groups = np.split(lines, np.flatnonzero(np.diff(lines) > 1) + 1)
    assert [float(group.mean()) + 0.5 for group in groups] == pytest.approx([75, 100, 125], abs=0.5)
    assert all(len(group) <= 3 for group in groups)


def test_values_beyond_the_bounds_have_their_colours_and_infinite_ones_none():
    values = np.array([-9.0, -9.0, -9.0, -9.0])
    below = drawn(square(field=Field(values, low=0.0, high=1.0)))[100, 100]
    np.testing.assert_allclose(hue(below), hue(colour_table("viridis")[0]), atol=0.08)
    unknown = drawn(square(field=Field(np.full(4, np.inf))))[100, 100]
    np.testing.assert_allclose(hue(unknown), hue(CLEAR.unknown), atol=0.05)


def test_a_constant_field_has_the_middle_colour():
    pixel = drawn(square(field=Field(np.full(4, 7.0), "coolwarm", contours=3)))[100, 100]
    np.testing.assert_allclose(hue(pixel), hue(colour_table("coolwarm")[128]), atol=0.05)


def test_vertices_have_their_own_colours():
    row = drawn(square(colours=np.array([RED, BLUE, BLUE, RED])))[100]
    np.testing.assert_allclose(hue(row[52]), hue(RED), atol=0.06)
    np.testing.assert_allclose(hue(row[148]), hue(BLUE), atol=0.06)


def test_a_tube_covers_its_length_and_round_ends():
    tube = Tube(np.array([[-0.5, 0, 0], [0.0, 0, 0], [0.0, 0, 0], [0.5, 0, 0]]), 0.1, RED)
    assert drawn(tube)[..., 3].sum() == pytest.approx(1e4 * (0.2 + np.pi * 0.01), rel=0.01)
    hairpin = Tube(np.array([[0.0, 0, 0], [0.5, 0, 0], [0.0, 0, 0]]), 0.1, RED)
    assert drawn(hairpin)[..., 3].sum() == pytest.approx(1e4 * (0.1 + np.pi * 0.01), rel=0.05)
    point = Tube(np.zeros((2, 3)), 0.1, RED)
    np.testing.assert_array_equal(drawn(point), drawn(Sphere((0.0, 0.0, 0.0), 0.1, RED)))


def test_the_orientation_of_faces_does_not_matter():
    body = figure("hand", 4)
    camera = fit_camera(body.vertices, view_axes(30, 10, "z"), (160, 160))
    flipped = body.faces.copy()
    some = np.random.default_rng(0).random(len(flipped)) < 0.5
    flipped[some] = flipped[some, ::-1]
    pictures = [
        render_scene(Scene((SceneMesh(body.vertices, faces),)), camera, (160, 160), CLEAR).astype(int)
        for faces in (body.faces, flipped)
    ]
    assert np.abs(pictures[0] - pictures[1]).max() <= 1


def test_edges_of_solids_are_sharp_and_curved_surfaces_smooth():
    corners = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    sides = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])
    faces = np.concatenate([sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]])
    camera = Camera(view_axes(45, 0, "z"), np.zeros(3), 4.0)
    row = render_scene(Scene((SceneMesh(corners, faces),)), camera, (200, 200), CLEAR)[100, :, :3].astype(int)
    left, right = row[45:95], row[105:155]
    assert np.ptp(left, axis=0).max() <= 2
    assert np.ptp(right, axis=0).max() <= 2
    assert np.abs(left.mean(axis=0) - right.mean(axis=0)).max() > 10
    ball = sphere(subdivisions=2)
    row = drawn(SceneMesh(ball.vertices, ball.faces), span=2.5)[100, 40:160, :3]
    assert np.abs(np.diff(row, axis=0)).max() < 0.03


def test_folds_are_darker():
    row = drawn(square(right=0.0, slope=-1.0), square(left=0.0, slope=1.0))[100, :, :3].sum(axis=1)
    assert row[97] < row[75] - 0.05
    assert row[102] < row[125] - 0.05


def test_faces_without_an_area_change_nothing():
    plain = square(colour=RED)
    more = SceneMesh(
        np.vstack([plain.vertices, [[0.0, 0.0, 0.0]]]), [*SQUARE, [0, 0, 1], [0, 2, 4], [4, 4, 4]], colour=RED
    )
    np.testing.assert_array_equal(drawn(plain), drawn(more))


def test_a_face_behind_the_eye_is_not_drawn():
    behind, across = square(depth=5.0), square(slope=10.0)
    assert drawn(behind, across, distance=2.0)[..., 3].max() == 0
    seen = drawn(behind, square(-0.2, 0.2, colour=RED), distance=2.0)
    assert seen[100, 100, 3] == 1


def test_faces_beside_the_picture_are_cut_off():
    pixels = drawn(square(-50.0, 50.0, -50.0, 50.0), square(5.0, 6.0, depth=1.0), square(low=9.0, high=10.0, depth=1.0))
    assert (pixels[..., 3] == 1).all()


def test_an_empty_scene_is_its_background():
    assert drawn().max() == 0
    for name in ("light", "dark"):
        pixels = drawn(theme=THEMES[name], size=(17, 33))
        assert pixels.shape == (33, 17, 4)
        np.testing.assert_allclose(pixels[0, 0], [*THEMES[name].background, 1.0], atol=1 / 255)


def test_a_background_lies_under_smooth_edges():
    ball = Sphere((0.0, 0.0, 0.0), 0.5, RED)
    clear, dark = drawn(ball), drawn(ball, theme=THEMES["dark"])
    whole = to_linear(clear[..., :3]) * clear[..., 3:] + (1 - clear[..., 3:]) * to_linear(
        np.array(THEMES["dark"].background)
    )
    np.testing.assert_allclose(to_srgb(whole), dark[..., :3], atol=2.5 / 255)


def test_a_picture_does_not_depend_on_the_threads():
    ring = torus()
    scene = [SceneMesh(ring.vertices / 2, ring.faces, field=Field(ring.vertices[:, 0], contours=9))]
    first = drawn(*scene, threads=1)
    for threads in (1, 2, 3):
        np.testing.assert_array_equal(drawn(*scene, threads=threads), first)


@pytest.mark.parametrize("size", [(160, 160), (300, 100), (64, 200)])
@pytest.mark.parametrize("perspective", [True, False])
def test_a_fitted_camera_shows_all_as_large_as_it_can(size, perspective):
    points = figure("quadruped", 1).vertices
    camera = fit_camera(points, view_axes(35, 14, "z"), size, perspective=perspective)
    seen = camera.pixels(points, size)
    low, high = seen.min(axis=0), seen.max(axis=0)
    margins = np.array([low, np.array(size) - high]) / min(size)
    assert margins.min() == pytest.approx(MARGIN, abs=2e-3)
    np.testing.assert_allclose(margins[0], margins[1], atol=5e-3)


@pytest.mark.parametrize(
    ("up", "near", "right"),
    [("z", [0, -1, 0], [1, 0, 0]), ("y", [0, 0, 1], [1, 0, 0]), ("x", [0, 0, -1], [0, 1, 0])],
)
def test_views_have_the_axes_that_they_name(up, near, right):
    top = np.eye(3)["xyz".index(up)]
    np.testing.assert_allclose(view_axes(0, 0, up), [right, top, near], atol=1e-12)
    np.testing.assert_allclose(view_axes(90, 0, up)[2], right, atol=1e-12)
    np.testing.assert_allclose(view_axes(0, 90, up)[2], top, atol=1e-12)
    axes = view_axes(33, -21, up)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert axes[1] @ top > 0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Field(np.zeros((2, 2))), "values must be"),
        (lambda: Field(np.zeros(2), "rainbow"), "colour_map must be one of"),
        (lambda: Field(np.zeros(2), low=1.0, high=0.0), "low must be at most high"),
        (lambda: Field(np.zeros(2), low=np.nan), "low must be at most high"),
        (lambda: Field(np.zeros(2), contours=-1), "contours"),
        (lambda: square(field=Field(np.zeros(3))), "values must be"),
        (lambda: square(field=Field(np.array([0.0, 1.0, np.nan, 0.0]))), "not a number"),
        (lambda: square(colours=np.zeros((3, 3))), "colours must be"),
        (lambda: square(left=np.nan), "not finite"),
        (lambda: square(depth=np.inf), "not finite"),
        (lambda: Tube(np.zeros((0, 3)), 1.0, RED), "points of a tube"),
        (lambda: Tube(np.full((2, 3), np.nan), 1.0, RED), "points of a tube"),
        (lambda: Tube(np.zeros((1, 3)), 0.0, RED), "radius"),
        (lambda: Sphere((0.0, 0.0, np.nan), 1.0, RED), "finite"),
        (lambda: Sphere((0.0, 0.0, 0.0), np.inf, RED), "radius"),
        (lambda: Camera(np.ones((3, 3)), np.zeros(3), 1.0), "orthonormal"),
        (lambda: Camera(np.eye(3), np.full(3, np.nan), 1.0), "centre"),
        (lambda: Camera(np.eye(3), np.zeros(3), 0.0), "above 0"),
        (lambda: Camera(np.eye(3), np.zeros(3), 1.0, -1.0), "above 0"),
        (lambda: view_axes(0, 0, "w"), "up must be one of"),
        (lambda: drawn(size=(15, 64)), "width must be"),
        (lambda: drawn(size=(64, 2049)), "height must be"),
        (lambda: drawn(size=(64.0, 64)), "width must be"),
        (lambda: drawn(square(), threads=0), "threads"),
    ],
)
def test_what_is_out_of_range_is_refused(make, words):
    with pytest.raises(ParameterError, match=words):
        make()


def test_a_mesh_needs_faces_of_its_vertices():
    for faces in (np.zeros((0, 3), int), [[0, 1, 9]], [[0, 1]]):
        with pytest.raises(MeshGeometryError):
            SceneMesh(np.zeros((3, 3)), faces)


def test_a_vertex_without_a_face_may_be_anything():
    plain = square(colour=RED)
    more = SceneMesh(np.vstack([plain.vertices, np.full((1, 3), np.nan)]), SQUARE, colour=RED)
    np.testing.assert_array_equal(drawn(plain), drawn(more))
