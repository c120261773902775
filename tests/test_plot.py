"""The figures: their artists, labels and limits."""

from __future__ import annotations

import io
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from tests.support.server import ply
from unbend import Library, Parameters, Surface, canonical_form, compute_signature, geodesic_distances, plot
from unbend.errors import ParameterError
from unbend.marks import COLOURS
from unbend.mesh.shapes import cylinder, sheet, sphere, torus

FEW = {"samples": 40}
MONEY = "$5_a^$"  # mathematics to matplotlib, unless it is told otherwise
SHAPES = [
    (MONEY, sheet(columns=12, rows=6), MONEY),
    ("rolled", cylinder(columns=12, rows=6), MONEY),
    ("ball", sphere(subdivisions=1), "_sphere"),  # matplotlib hides labels that begin with an underscore
    ("ring", torus(columns=12, rows=8), None),
]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    with Library(str(tmp_path_factory.mktemp("plot") / "library.db")) as opened:
        for name, surface, label in SHAPES:
            opened.add(ply(surface), name=name, label=label, parameters=FEW)
        yield opened


@pytest.fixture(scope="module")
def ranking(library):
    return library.rank(compute_signature(SHAPES[0][1], FEW))


def drawn(figure) -> bytes:
    """Draw a figure, which raises what is wrong with its texts."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=30)
    return file.getvalue()


def texts(legend) -> list[str]:
    return [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("dimensions", [3, 5])
def test_a_form_in_space_has_every_triangle_and_equal_units(dimensions, whole):
    surface = torus(columns=12, rows=8)
    signature = compute_signature(surface, Parameters(samples=40, dimensions=dimensions))
    shown = canonical_form(surface, signature=signature) if whole else signature
    figure = plot.form(shown)
    (axes,) = figure.axes
    (solid,) = axes.collections
    lengths = np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1)
    assert lengths / axes.get_box_aspect() == pytest.approx(lengths[0] / axes.get_box_aspect()[0])
    assert (lengths >= np.ptp(shown.points[:, :3], axis=0)).all()
    assert axes.get_title() == f"{len(shown.points)} points in {dimensions} dimensions, stress {signature.stress:.3g}"
    drawn(figure)
    assert len(solid.get_paths()) == len(shown.faces)


@pytest.mark.parametrize("dimensions", [1, 2])
def test_a_form_in_the_plane_has_every_point(dimensions):
    signature = compute_signature(SHAPES[1][1], Parameters(samples=40, dimensions=dimensions))
    figure = plot.form(signature)
    (axes,) = figure.axes
    points = axes.lines[-1].get_xydata()
    assert points[:, :dimensions] == pytest.approx(signature.points)
    assert (points[:, dimensions:] == 0).all()
    assert len(axes.lines) == (1 if dimensions == 1 else 3)  # triangulations are two lines
    assert axes.get_title().startswith(f"40 points in {dimensions} dimension")
    drawn(figure)


def test_a_field_has_a_colour_for_each_face_and_a_bar():
    surface = torus(columns=12, rows=8)
    distances = geodesic_distances(surface, 0)[0]
    figure = plot.field(surface, distances, label=MONEY)
    axes, bar = figure.axes
    (solid,) = axes.collections
    means = distances[surface.faces].mean(axis=1)
    assert np.asarray(solid.get_array()) == pytest.approx(means)
    assert solid.get_clim() == (means.min(), means.max())
    assert bar.get_ylabel() == MONEY
    for axis, limits in enumerate((axes.get_xlim(), axes.get_ylim(), axes.get_zlim())):
        assert limits[0] <= surface.vertices[:, axis].min()
        assert limits[1] >= surface.vertices[:, axis].max()
    drawn(figure)


def test_a_flat_surface_can_be_plotted():
    surface = sheet(columns=4, rows=2)
    drawn(plot.field(surface, surface.vertices[:, 0]))
    drawn(plot.form(compute_signature(surface, FEW)))


def test_faces_without_a_finite_value_are_grey():
    surface = Surface(np.vstack([np.eye(3), np.eye(3) + 5]), [[0, 1, 2], [3, 4, 5]])
    figure = plot.field(surface, geodesic_distances(surface, 0)[0])
    drawn(figure)
    (solid,) = figure.axes[0].collections
    colours = {to_hex(colour) for colour in solid.get_facecolor()}
    assert "#b9b9b9" in colours
    assert len(colours) == 2


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((861, 1)), 0.0])
def test_a_field_needs_a_value_for_each_vertex(values):
    with pytest.raises(ParameterError, match=r"one number for each of the \d+ vertices"):
        plot.field(torus(), values)


def test_a_field_needs_a_finite_value_and_a_known_colour_map():
    surface = torus(columns=12, rows=8)
    with pytest.raises(ParameterError, match="no face has finite values"):
        plot.field(surface, np.full(len(surface.vertices), np.nan))
    with pytest.raises(ParameterError, match="no colour map 'rainbows'"):
        plot.field(surface, np.zeros(len(surface.vertices)), colours="rainbows")


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_a_map_has_a_point_for_each_shape_on_both_sides(library, dimensions):
    found = library.map(parameters=Parameters(**FEW), dimensions=dimensions)
    figure = plot.map(found)
    for axes, which in zip(figure.axes, ("point", "original"), strict=True):
        points = np.concatenate([line.get_xydata() for line in axes.lines])
        expected = np.array([getattr(item, which) for item in found.items])[:, :2]
        assert len(points) == len(SHAPES)
        assert {*map(tuple, points[:, : expected.shape[1]])} == {*map(tuple, expected)}
        assert len({line.get_color() for line in axes.lines}) == 3
    assert [axes.get_title().split(",")[0] for axes in figure.axes] == ["by spectrum", "by the surfaces in space"]
    (legend,) = figure.legends
    assert texts(legend) == [MONEY, "_sphere", "(no class)"]
    drawn(figure)


def test_a_ranking_has_a_bar_for_each_shape_with_the_nearest_on_top(ranking):
    figure = plot.ranking(ranking)
    (axes,) = figure.axes
    assert [bar.get_width() for bar in axes.patches] == [match.distance for match in ranking.shapes]
    assert [label.get_text() for label in axes.get_yticklabels()] == [match.name for match in ranking.shapes]
    assert axes.yaxis_inverted()
    assert axes.get_xlabel() == "distance by spectrum"
    assert {to_hex(bar.get_facecolor()) for bar in axes.patches} == {*COLOURS[:2], "#8c8c8c"}
    assert texts(figure.legends[0]) == [MONEY, "_sphere", "(no class)"]
    drawn(figure)
    assert len(plot.ranking(ranking, most=2).axes[0].patches) == 2


def test_bars_of_many_classes_differ_in_colour_or_hatch(ranking):
    (match, *_) = ranking.shapes
    many = replace(ranking, shapes=[replace(match, label=f"class {place:02}") for place in range(20)])
    bars = plot.ranking(many).axes[0].patches
    assert len({(to_hex(bar.get_facecolor()), bar.get_hatch()) for bar in bars}) == 20


def test_an_empty_result_is_an_empty_figure(library, ranking):
    empty = plot.ranking(replace(ranking, shapes=[]))
    assert not empty.axes[0].patches
    assert not empty.legends
    drawn(empty)
    found = library.map(parameters=Parameters(**FEW))
    drawn(plot.map(replace(found, items=[])))


def test_pyplot_is_left_alone():
    code = "import sys, unbend.plot; print('matplotlib.pyplot' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "False"


def test_a_surface_is_no_form():
    with pytest.raises(ParameterError, match="Surface is neither a Signature nor a CanonicalForm") as raised:
        plot.form(sheet())
    assert "unbend.canonical_form" in raised.value.advice
