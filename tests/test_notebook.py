"""Notebooks show well-formed HTML with pictures, in which names are text only."""

from __future__ import annotations

import io
import subprocess
import sys
from base64 import b64decode
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from PIL import Image

from tests.support.server import ply, two_rings
from unbend import Library, Parameters, canonical_form, compute_signature, read_mesh
from unbend.errors import ParameterError
from unbend.mesh.shapes import cylinder, sheet, sphere, torus
from unbend.notebook.html import MOST_MARKS, MOST_ROWS, figure_html, gallery_html, map_html, ranking_html
from unbend.render.notebook import html_of, thumbnail
from unbend.results import PartRelation

FEW = {"samples": 40}
PART = PartRelation("part", 0.5, 1.0, 0.0, 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
EVIL = "<script>alert('1')</script> & \"quotes\""
SHAPES = [
    (EVIL, sheet(columns=12, rows=6), EVIL),
    ("rolled", cylinder(columns=12, rows=6), EVIL),
    ("ball", sphere(subdivisions=1), "sphere"),
    ("ring", torus(columns=12, rows=8), None),
]
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    with Library(str(tmp_path_factory.mktemp("notebook") / "library.db")) as opened:
        for name, surface, label in SHAPES:
            opened.add(ply(surface), name=name, label=label, parameters=FEW)
        yield opened


@pytest.fixture(scope="module")
def ranking(library):
    return library.rank(compute_signature(SHAPES[0][1], FEW))


def parsed(html: str) -> ET.Element:
    """Return the tree of a fragment, which must be well-formed and have no scripts."""
    tree = ET.fromstring(html)  # noqa: S314  our own text
    assert not [*tree.iter("script")]
    return tree


def texts(tree: ET.Element, tag: str) -> list[str]:
    return ["".join(element.itertext()).strip() for element in tree.iter(tag)]


def picture_in(tree: ET.Element) -> np.ndarray:
    (image,) = tree.iter("img")
    kind, data = image.get("src", "").split(";base64,")
    assert kind == "data:image/webp"
    return pixels_of(b64decode(data))


def pixels_of(file: bytes) -> np.ndarray:
    return np.array(Image.open(io.BytesIO(file)).convert("RGBA"))


def test_a_surface_is_shown_by_its_picture_and_its_repr():
    surface = torus()
    tree = parsed(surface._repr_html_())
    pixels = picture_in(tree)
    assert 0.1 < (pixels[..., 3] > 0).mean() < 0.9  # the body on a transparent ground
    assert texts(tree, "figcaption") == [repr(surface)]
    assert not texts(tree, "li")


def test_warnings_are_listed():
    surface = read_mesh(two_rings(0))
    assert texts(parsed(surface._repr_html_()), "li") == list(surface.report.warnings) != []


@pytest.mark.parametrize("dimensions", [1, 2, 3, 5])
def test_a_signature_is_shown_by_its_form(dimensions):
    surface = cylinder(columns=12, rows=6)
    signature = compute_signature(surface, Parameters(samples=40, dimensions=dimensions))
    for value in (signature, canonical_form(surface, signature=signature)):
        tree = parsed(value._repr_html_())
        assert texts(tree, "figcaption") == [repr(value)]
        if dimensions > 1:  # a line has no area to draw
            assert (picture_in(tree)[..., 3] > 0).mean() > 0.02


def test_the_form_of_a_signature_has_another_colour_than_its_surface():
    surface = sphere(subdivisions=2)
    pictures = [picture_in(parsed(shown._repr_html_())) for shown in (surface, compute_signature(surface, FEW))]
    blue, red = ((picture[picture[..., 3] > 200][:, :3].astype(int)).mean(axis=0) for picture in pictures)
    assert blue[2] > blue[0]
    assert red[0] > red[2]


def test_a_signature_without_triangles_is_shown_in_words():
    signature = replace(compute_signature(SHAPES[0][1], FEW), faces=np.empty((0, 3), np.int32))
    tree = parsed(signature._repr_html_())
    assert not [*tree.iter("img")]
    assert texts(tree, "code") == [repr(signature)]


def test_only_values_with_pictures_have_html():
    with pytest.raises(ParameterError, match="int has no picture"):
        html_of(3)


def test_names_and_labels_are_text(library, ranking):
    for html in (
        ranking_html(ranking),
        map_html(library.map(parameters=Parameters(**FEW))),
        figure_html(None, EVIL, [EVIL]),
        gallery_html({EVIL: thumbnail(SHAPES[2][1])}),
    ):
        assert "<script" not in html
        assert EVIL in "".join(parsed(html).itertext())


def test_notebooks_show_rankings_and_maps(library, ranking):
    assert ranking._repr_html_() == ranking_html(ranking)
    shape_map = library.map(parameters=Parameters(**FEW))
    assert shape_map._repr_html_() == map_html(shape_map)


def test_a_gallery_has_each_picture_above_its_caption():
    drawn = {"ball": thumbnail(sphere(1)), "ring": thumbnail(torus())}
    figures = [*parsed(gallery_html(drawn)).iter("figure")]
    assert [texts(figure, "figcaption") for figure in figures] == [["ball"], ["ring"]]
    for figure, file in zip(figures, drawn.values(), strict=True):
        assert np.array_equal(picture_in(figure), pixels_of(file))


def test_a_ranking_is_two_tables(ranking):
    classes, shapes = parsed(ranking_html(ranking)).iter("tbody")
    assert texts(classes, "bdi") == [match.label for match in ranking.classes]
    rows = [[*row] for row in shapes.iter("tr")]
    assert ["".join(row[1].itertext()) for row in rows] == [match.name for match in ranking.shapes]
    assert ["".join(row[2].itertext()) for row in rows] == [match.label or "" for match in ranking.shapes]
    assert [float(row[3].text or "") for row in rows] == pytest.approx(
        [match.distance for match in ranking.shapes], rel=1e-3
    )


@pytest.mark.parametrize(("known", "said"), [(True, "Known"), (False, "Unknown"), (None, "")])
def test_a_ranking_says_whether_the_query_is_known_and_why_it_may_be_wrong(ranking, known, said):
    tree = parsed(ranking_html(replace(ranking, known=known, warnings=[EVIL])))
    assert "".join(texts(tree, "p")).partition(":")[0] == said
    assert texts(tree, "li") == [EVIL]


def test_a_ranking_shows_given_pictures(ranking):
    first, second = ranking.shapes[:2]
    tree = parsed(ranking_html(ranking, {second.id: thumbnail(torus())}))
    (image,) = tree.iter("img")
    assert image.get("alt") == second.name
    assert "picture" in texts(tree, "th")
    assert "picture" not in texts(parsed(ranking_html(ranking)), "th")
    assert first.id not in ranking_html(ranking)


def test_a_long_ranking_says_how_many_rows_are_missing(ranking):
    long = replace(ranking, shapes=[*ranking.shapes] * 5, classes=[])
    tree = parsed(ranking_html(long))
    assert len(texts([*tree.iter("tbody")][1], "tr")) == MOST_ROWS
    assert f"and {len(long.shapes) - MOST_ROWS} more" in texts(tree, "p")
    assert not [text for text in texts(parsed(ranking_html(long, most=99)), "p") if "more" in text]


def test_a_ranking_of_parts_has_a_column_for_them(ranking):
    (match, *others) = ranking.shapes
    tree = parsed(ranking_html(replace(ranking, shapes=[replace(match, part=PART), *others])))
    assert "the query is" in texts(tree, "th")
    assert "part" in texts(tree, "td")


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_a_map_has_a_mark_for_each_shape_within_its_frame(library, dimensions):
    found = library.map(parameters=Parameters(**FEW), dimensions=dimensions)
    tree = parsed(map_html(found))
    plane = tree.find(f"{SVG}svg")
    marks = list(plane.iter(f"{SVG}path"))
    assert [path[0].text.split(" (")[0] for path in marks] == [item.name for item in found.items]
    places = np.array([[float(part) for part in path.get("transform")[10:-1].split()] for path in marks])
    assert (places > 0).all()
    assert (places < [int(plane.get("width")), int(plane.get("height"))]).all()
    if dimensions == 2:  # the distances of the map, in pixels, the second axis upwards
        away = places[0] - places[1:]
        between = np.array(found.items[0].point) - np.array([item.point for item in found.items[1:]])
        assert away * [1, -1] == pytest.approx(between * np.abs(away).max() / np.abs(between).max(), abs=0.2)
    looks = {path[0].text.split("(")[-1]: path.get("fill") for path in marks}
    assert len(set(looks.values())) == 3  # two classes, and none
    assert set(texts(tree, "bdi")) == {EVIL, "sphere"}


def test_a_large_map_is_thinned_and_an_empty_one_is_shown(library):
    found = library.map(parameters=Parameters(**FEW))
    many = replace(found, items=found.items * MOST_MARKS)
    assert map_html(many).count("<title>") == MOST_MARKS
    assert map_html(replace(found, items=[])).count("<title>") == 0


def test_nothing_is_drawn_before_a_notebook_shows_it():
    code = (
        "import sys; from unbend.mesh.shapes import tetrahedron; made = tetrahedron();"
        "before = [m for m in ('PIL', 'jinja2', 'unbend.render') if m in sys.modules]; made._repr_html_();"
        "print(before, 'unbend.render' in sys.modules)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[] True"


def test_tiny_confidences_and_code_in_warnings_are_readable(ranking):
    (match, *others) = ranking.classes
    shown = replace(
        ranking,
        classes=[replace(match, confidence=0.987), *(replace(other, confidence=5.26e-16) for other in others)],
        warnings=["ask with the measure `partial`", "a single ` stays"],
    )
    tree = parsed(ranking_html(shown))
    classes, _ = tree.iter("tbody")
    assert [texts(row, "td")[-1] for row in classes] == ["98.7 %", *["< 0.1 %"] * len(others)]
    assert texts(tree, "code") == ["partial"]
    assert texts(tree, "li")[1] == "a single ` stays"


def test_an_empty_map_says_why(library):
    tree = parsed(map_html(library.map(parameters=Parameters(samples=77))))
    assert "no shape has the parameters of the query" in "".join(texts(tree, "li"))
