"""The HTML report of an evaluation, parsed like in a browser."""

from __future__ import annotations

import base64
import io
import re
import xml.etree.ElementTree as ET
from datetime import date
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from unbend.matching.evaluate import evaluate
from unbend.matching.evaluate.report import Report, ShapePicture, render

VOID = {"meta", "link", "img", "br", "hr", "input"}
HOSTILE = "</td><script>alert('1')</script>\"&amp;<!--"
CLASS = "<b onclick=alert(2)>"
MEASURE = "<i>near</i>"
REASON = '"]]></style><img src=x onerror=alert(3)>'


class Page(HTMLParser):
    """A parsed page: its elements in order, each with its attributes and its text."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None], list[str]]] = []
        self._open: list[int] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs), []))
        assert len({name for name, _ in attrs}) == len(attrs)
        if tag not in VOID:
            self._open.append(len(self.elements) - 1)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs), []))

    def handle_endtag(self, tag):
        assert self.elements[self._open.pop()][0] == tag

    def handle_data(self, data):
        for place in self._open:
            self.elements[place][2].append(data)

    def texts(self, tag: str, **attributes: str) -> list[str]:
        return [
            " ".join("".join(inside).split())
            for name, own, inside in self.elements
            if name == tag and attributes.items() <= own.items()
        ]


def made(*, left_out: bool = True, **others: object) -> Report:
    """Make a report of three classes, one with a malicious name; only the first measure confuses two classes."""
    labels = ["cat"] * 3 + [CLASS] * 3 + ["ant"] * 2
    places = np.array([0.0, 1.0, 5.1, 5.0, 8.0, 8.5, 20.0, 21.0])
    codes = np.array([0, 0, 0, 1, 1, 1, 2, 2])
    distances = {
        MEASURE: np.abs(places[:, None] - places),
        "far": np.abs(codes[:, None] - codes) + np.abs(places[:, None] - places) / 100,
    }
    own = np.arange(8) if left_out else None
    names = [f"{row}.off" for row in range(8)]
    names[2] = HOSTILE
    if left_out:
        evaluations = {name: evaluate(rows, labels, labels, own=own) for name, rows in distances.items()}
    else:
        evaluations = {
            name: evaluate(rows[1::2], labels[1::2], labels[::2], unanswered=["owl"])
            for name, rows in ((name, rows[:, ::2]) for name, rows in distances.items())
        }
    values: dict[str, object] = {
        "title": f"Evaluation of {CLASS}",
        "evaluations": evaluations,
        "queries": names if left_out else names[1::2],
        "gallery": names if left_out else names[::2],
        "left_out": left_out,
        "failures": [(HOSTILE + "2", REASON)],
        "settings": {"samples": 300, "max_vertices": None, "folder": HOSTILE},
        "version": "9.8.7",
        "date": date(2003, 10, 1),
    }
    return Report(**(values | others))


@pytest.fixture(scope="module")
def text() -> str:
    return render(made())


@pytest.fixture(scope="module")
def page(text) -> Page:
    return Page(text)


def section_text(text: str, identity: str) -> str:
    return re.search(rf'<section id="{identity}".*?</section>', text, re.DOTALL)[0]


def section(text: str, identity: str) -> Page:
    return Page(section_text(text, identity))


def rows(page: Page, caption: str) -> list[list[str]]:
    """Return the cells of the table whose caption starts with `caption`."""
    found: list[list[str]] = []
    inside = False
    for tag, _, parts in page.elements:
        reported = " ".join("".join(parts).split())
        if tag == "table":
            inside = reported.startswith(caption)
        elif inside and tag == "tr":
            found.append([])
        elif inside and tag in {"th", "td"}:
            found[-1].append(reported)
    return found


# --- safety


def test_the_page_loads_no_resources_and_runs_no_scripts(text, page):
    assert not re.search(r"https?://|url\(|@import|javascript:", text)
    for tag, attributes, _ in page.elements:
        assert tag not in {"script", "link", "img", "iframe", "object", "embed", "form", "base", "b", "i"}
        assert not any(name.startswith("on") or name in {"src", "srcset", "style"} for name in attributes)
        assert (attributes.get("href") or "#").startswith("#")
        assert "xlink:href" not in attributes
    policy = next(own["content"] for _, own, _ in page.elements if own.get("http-equiv") == "Content-Security-Policy")
    assert policy == "default-src 'none'; style-src 'unsafe-inline'"


def test_names_of_files_and_classes_are_escaped(text, page):
    shown = page.texts("bdi")
    for name in (HOSTILE, CLASS, MEASURE, HOSTILE + "2", REASON):
        assert name in shown
    assert f"Evaluation of {CLASS}" == page.texts("title")[0]
    assert "<script" not in text
    assert any(CLASS in title for title in page.texts("title")[1:])


# --- content


def test_the_header_has_the_data_the_date_and_the_version(text, page):
    head = page.texts("header")[0]
    assert "each of 8 shapes was a query against all the others" in head
    assert "3 classes" in head
    assert "1 file could not be used" in head
    assert "unbend 9.8.7 on 2003-10-01" in head
    assert rows(page, "The settings of")[1:] == [["samples", "300"], ["max_vertices", "none"], ["folder", HOSTILE]]
    assert rows(page, "1 file")[1:] == [[HOSTILE + "2", REASON]]
    clean = render(made(failures=[]))
    assert "Every file could be used." in clean
    assert 'id="failures"' not in clean


def test_the_headline_has_the_metrics_of_every_measure(page):
    table = rows(page, "Means over all queries")
    assert table[0] == ["Measure", "NN", "FT", "ST", "E", "DCG", "mAP", "Wrong answers"]
    report = made()
    for row, (name, found) in zip(table[1:], report.evaluations.items(), strict=True):
        assert row[:-1] == [name, *(f"{value:.3f}" for value in vars(found.metrics).values())]
    assert [row[-1] for row in table[1:]] == ["2 of 8", "0 of 8"]


def test_classes_are_sorted_by_nn_and_wrong_answers_are_listed(text):
    first, second = section(text, "measure-1"), section(text, "measure-2")
    table = rows(first, "Means over each class")
    assert table[0] == ["Class", "Queries", "Members", "NN", "FT", "ST", "E", "DCG", "mAP"]
    assert [row[:4] for row in table[1:]] == [
        [CLASS, "3", "3", "0.667"], ["cat", "3", "3", "0.667"], ["ant", "2", "2", "1.000"],
    ]  # fmt: skip
    wrong = rows(first, "Queries whose nearest shape")
    assert wrong[1:] == [[HOSTILE, "cat", "3.off", CLASS, "0.1"], ["3.off", CLASS, HOSTILE, "cat", "0.1"]]
    assert "every query's nearest shape is of its class" in " ".join(second.texts("p"))


def test_the_confusion_matrix_places_and_names_every_cell_that_is_not_empty(text):
    drawing = ET.fromstring(re.search(r"<svg.*?</svg>", section_text(text, "measure-1"), re.DOTALL)[0])  # noqa: S314
    assert drawing.find("title").text == f"Confusion matrix of {MEASURE}"
    labels = [label.find("title").text for label in drawing.findall("g/text")]
    assert labels == [CLASS, CLASS, "ant", "ant", "cat", "cat"]  # each for its row and its column
    cells = {}
    for cell in drawing.findall("g/g"):
        x, y = map(float, re.findall(r"[\d.]+", cell.get("transform")))
        side = float(cell.find("rect").get("width"))
        reported = (" ".join(cell.find("title").text.split()), cell.find("text").text, cell.get("class"))
        cells[labels[2 * int(y / side)], labels[2 * int(x / side)]] = reported
    assert cells == {
        (CLASS, CLASS): (f"2 of class {CLASS}: nearest are {CLASS} (67 %)", "2", "right"),
        (CLASS, "cat"): (f"1 of class {CLASS}: nearest is cat (33 %)", "1", "wrong"),
        ("ant", "ant"): ("2 of class ant: nearest are ant (100 %)", "2", "right"),
        ("cat", CLASS): (f"1 of class cat: nearest is {CLASS} (33 %)", "1", "wrong"),
        ("cat", "cat"): ("2 of class cat: nearest are cat (67 %)", "2", "right"),
    }


def test_the_plot_has_the_precision_recall_curve_of_every_measure(text):
    drawing = ET.fromstring(re.search(r"<svg.*?</svg>", section_text(text, "precision-recall"), re.DOTALL)[0])  # noqa: S314
    curves = drawing.findall("g[@class]")[1:]
    for curve, (name, found) in zip(curves, made().evaluations.items(), strict=True):
        line, legend = (each.get("points") for each in curve.iter("polyline"))
        assert legend == "0,0 28,0"
        assert curve.find(".//text").text == name
        points = np.array([point.split(",") for point in line.split()], float)
        expected = found.precision_recall
        # Convert the coordinates back to precision and recall by the grid lines at 0 and 1.
        grid = [tuple(map(float, re.findall(r"[\d.]+", path.get("d")))) for path in drawing.findall("g/path")[:6]]
        (left, bottom), (right, top) = ((lines[0], lines[1]) for lines in (grid[0], (grid[0][2], grid[5][1])))
        np.testing.assert_allclose((points[:, 0] - left) / (right - left), expected.recall, atol=1e-3)
        np.testing.assert_allclose((points[:, 1] - bottom) / (top - bottom), expected.precision, atol=1e-3)
        titles = [title.text for title in curve.iter("title")]
        assert titles[-1] == f"{name}: precision {expected.precision[-1]:.3f} at recall 1.00"
    assert len({curve.get("class") for curve in curves}) == 2
    assert len({curve.find("path").get("d") for curve in curves}) == 2  # curves do not differ by colour alone


def test_the_numbers_of_the_plot_are_also_in_a_table(page):
    table = rows(page, "Mean precision")
    found = list(made().evaluations.values())
    assert table[0] == ["Recall", MEASURE, "far"]
    for row, recall, *precision in zip(
        table[1:], found[0].precision_recall.recall, *(each.precision_recall.precision for each in found), strict=True
    ):
        assert row == [f"{recall:.2f}", *(f"{value:.3f}" for value in precision)]


def test_a_report_against_a_gallery_has_accuracies_and_dashes_for_missing_metrics():
    page = Page(render(made(left_out=False)))
    assert "5 queries were compared with 4 other shapes" in page.texts("header")[0]
    table = rows(page, "Means over all queries")
    found = next(iter(made(left_out=False).evaluations.values()))
    assert table[0][1] == "Accuracy"
    assert table[1][1] == f"{found.accuracy:.3f}"
    owl = next(row for row in rows(page, "Means over each class") if row[0] == "owl")
    assert owl == ["owl", "1", "0", "0.000", "-", "-", "-", "-", "-", "-"]


def test_long_names_are_cut_in_the_drawing_but_complete_in_its_titles():
    labels = [f"class {row // 2} " + "x" * 300 for row in range(120)]
    found = evaluate(np.abs(np.arange(120.0)[:, None] - np.arange(120)), labels, labels, own=np.arange(120))
    names = [str(row) for row in range(120)]
    text = render(made(evaluations={"far": found}, queries=names, gallery=names))
    titles = Page(text).texts("title")
    assert all(titles.count(label) == 2 for label in set(labels))  # one for its row and one for its column
    widths = [float(own["width"]) for tag, own, _ in Page(text).elements if tag == "svg"]
    assert max(widths) < 60 * 30 + 250


# --- accessibility


def test_tables_and_drawings_are_accessible(text, page):
    identities = [own["id"] for _, own, _ in page.elements if "id" in own]
    assert len(set(identities)) == len(identities)
    for tag, own, _ in page.elements:
        if tag == "th":
            assert own["scope"] in {"col", "row"}
        if tag == "svg":
            assert own["role"] == "img"
            assert set(own["aria-labelledby"].split()) <= set(identities)
        if (own.get("href") or "").startswith("#"):
            assert own["href"][1:] in identities
    assert text.count("<caption>") == text.count("<table")
    assert '<html lang="en">' in text


def colours(style: str) -> dict[str, str]:
    return dict(re.findall(r"--([\w-]+): (#\w{6})", style))


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of WCAG 2, from 1 to 21."""

    def luminance(colour: str) -> float:
        parts = np.array([int(colour[start : start + 2], 16) / 255 for start in (1, 3, 5)])
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_light_dark_and_print_styles_have_enough_contrast(text):
    light, rest = text.split("<style>")[1].split("@media (prefers-color-scheme: dark)")
    dark, paper = rest.split("@media print")
    for style in (light, dark, paper):
        found = colours(style)
        assert len([name for name in found if name.startswith("colour-")]) == 6
        for name in ("ink", "quiet", "link"):
            assert contrast(found[name], found["paper"]) >= 4.5
            assert contrast(found[name], found["stripe"]) >= 4.5
        for name in ("right", "wrong"):  # background of cells of the matrix, with counts in ink
            assert contrast(found[name], found["ink"]) >= 4.5
            assert contrast(found[name], found["paper"]) >= 3
        for place in range(6):
            assert contrast(found[f"colour-{place}"], found["paper"]) >= 3


def test_class_maps_show_every_shape_once_inside_the_frame():
    rng = np.random.default_rng(0)
    report = made(maps={MEASURE: rng.normal(0, 1e-3, (8, 2)), "far": np.zeros((8, 2))})
    text = render(report)
    found = re.findall(r"<svg.*?</svg>", section_text(text, "maps"), re.DOTALL)
    drawings = [ET.fromstring(drawing) for drawing in found]  # noqa: S314
    assert len(drawings) == 2
    for drawing in drawings:
        marks = [path for path in drawing.iter("path") if path.get("class", "").startswith("mark")]
        assert len(marks) == 8
        assert {HOSTILE in (mark.find("title").text or "") for mark in marks} == {True, False}
        for mark in marks:
            x, y = (float(number) for number in re.findall(r"[-\d.]+", mark.get("transform")))
            assert 0 < x < float(drawing.get("width"))
            assert 0 < y < float(drawing.get("height"))
        assert sorted(name.text for name in drawing.iter("text")) == sorted([CLASS, "ant", "cat"])
    assert len({mark.get("class") for mark in drawings[0].iter("path")}) == 3
    assert "<script" not in text
    assert 'id="maps"' not in render(made())


# --- pictures


def webp(shade: int) -> bytes:
    target = io.BytesIO()
    Image.new("RGBA", (128, 128), (shade, 0, 0, 128)).save(target, "WEBP", lossless=True)
    return target.getvalue()


def pictures_in(text: str) -> dict[str, bytes]:
    """Return the files in a page by the ids of their elements."""
    start = "data:image/webp;base64,"
    images = [own for tag, own, _ in Page(text).elements if tag == "image"]
    assert all(own["href"].startswith(start) for own in images)
    return {own["id"]: base64.b64decode(own["href"].removeprefix(start), validate=True) for own in images}


def shown_in(text: str) -> list[tuple[str, str]]:
    """Return the text and the id of the image of every picture that a part of a page shows."""
    found = re.findall(r'<svg class="picture" role="img".*?</svg>', text, re.DOTALL)
    parsed = [ET.fromstring(each) for each in found]  # noqa: S314
    return [(each.find("title").text, each.find("use").get("href").removeprefix("#")) for each in parsed]


def labelled_pictures(report: Report) -> list[ShapePicture]:
    found = next(iter(report.evaluations.values()))
    labels = [found.labels[code] for code in found.query_classes]
    return [ShapePicture(name, labels[place], webp(place)) for place, name in enumerate(report.queries)]


def large_report(classes: int, members: int) -> Report:
    """Make a report of two measures, under which every answer is wrong, with a picture of each shape."""
    labels = [f"class {row % classes:03}" for row in range(classes * members)]
    names = [f"{row}.off" for row in range(len(labels))]
    same = np.array(labels)[:, None] == np.array(labels)
    found = evaluate(same + np.random.default_rng(0).random(same.shape) / 2, labels, labels, own=np.arange(len(labels)))
    file = webp(1)
    return made(
        evaluations={"one": found, "two": found}, queries=names, gallery=names,
        pictures=[ShapePicture(name, label, file) for name, label in zip(names, labels, strict=True)],
    )  # fmt: skip


def test_each_shape_has_its_picture_in_the_row_of_its_class_and_beside_wrong_answers():
    pictures = labelled_pictures(made())
    text = render(made(pictures=pictures))
    files = pictures_in(text)
    assert sorted(files.values()) == sorted(picture.file for picture in pictures)  # each is in the page once
    for file in files.values():
        assert Image.open(io.BytesIO(file)).convert("RGBA").size == (128, 128)
    alternatives = {f"{picture.name}, of class {picture.label}": picture.file for picture in pictures}
    in_classes = shown_in(section_text(text, "shapes"))
    assert {title: files[identity] for title, identity in in_classes} == alternatives
    assert len(in_classes) == 8
    assert section(text, "shapes").texts("th", scope="row") == [f"{CLASS} 3 of 3", "ant 2 of 2", "cat 3 of 3"]
    confused = shown_in(section_text(text, "measure-1"))
    assert [title for title, _ in confused] == [
        f"{HOSTILE}, of class cat", f"3.off, of class {CLASS}", f"3.off, of class {CLASS}", f"{HOSTILE}, of class cat",
    ]  # fmt: skip
    assert all(files[identity] == alternatives[title] for title, identity in confused)
    assert shown_in(section_text(text, "measure-2")) == []


def test_a_page_with_pictures_loads_nothing_else():
    page = Page(text := render(made(pictures=labelled_pictures(made()))))
    assert not re.search(r"https?://|url\(|@import|javascript:|<script", text)
    for tag, own, _ in page.elements:
        assert tag not in {"script", "link", "img", "iframe", "object", "embed", "form", "base", "b", "i"}
        assert not any(name.startswith("on") or name in {"src", "srcset", "style"} for name in own)
        assert (own.get("href") or "#").startswith("data:image/webp;base64," if tag == "image" else "#")
        assert tag != "svg" or own.get("role") == "img" or own.get("aria-hidden") == "true"
    identities = [own["id"] for _, own, _ in page.elements if "id" in own]
    assert len(set(identities)) == len(identities)
    assert text.count("<caption>") == text.count("<table")
    policy = next(own["content"] for _, own, _ in page.elements if own.get("http-equiv") == "Content-Security-Policy")
    assert policy == "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def test_a_page_without_pictures_has_no_section_for_them(text):
    assert pictures_in(text) == {}
    assert shown_in(text) == []
    assert 'id="shapes"' not in text
    assert 'href="#shapes"' not in text


def test_the_row_of_a_class_shows_at_most_8_members_from_its_whole_list():
    text = render(large_report(3, 20))
    shown = shown_in(section_text(text, "shapes"))
    for label in ("class 000", "class 001", "class 002"):
        places = [int(title.split(".")[0]) for title, _ in shown if title.endswith(label)]
        assert len(places) == 8
        assert places[0] < 3
        assert places[-1] >= 57
    assert "class 000 8 of 20" in section(text, "shapes").texts("th")
    assert "pictures of 60 of the 60 shapes" in section(text, "shapes").texts("p")[0]  # all are wrong answers


@pytest.mark.parametrize(("classes", "members"), [(30, 20), (450, 2)])
def test_a_page_has_at_most_400_pictures_and_half_are_for_wrong_answers(classes, members):
    text = render(large_report(classes, members))
    files = pictures_in(text)
    assert len(files) == 400
    assert {identity for _, identity in shown_in(text)} == set(files)
    said = section(text, "shapes").texts("p")[0]
    assert f"pictures of 400 of the {classes * members} shapes" in said
    assert "at most 400" in said
    confused = shown_in(section_text(text, "measure-1"))
    assert len({identity for _, identity in confused}) >= 200
    assert shown_in(section_text(text, "measure-2")) == confused


def test_the_page_says_how_many_classes_have_no_picture():
    few, many = (section(render(large_report(*size)), "shapes") for size in ((30, 20), (450, 2)))
    assert len(few.texts("th", scope="row")) == 30
    assert "no picture" not in few.texts("p")[0]
    with_picture = len(many.texts("th", scope="row"))
    assert 200 <= with_picture < 450
    assert f"{450 - with_picture} of 450 classes have no picture" in many.texts("p")[0]


def test_files_without_a_picture_are_shown_by_name():
    pictures = [picture for picture in labelled_pictures(made()) if picture.name != "3.off"]
    text = render(made(pictures=pictures))
    assert {title for title, _ in shown_in(section_text(text, "measure-1"))} == {f"{HOSTILE}, of class cat"}
    assert rows(section(text, "measure-1"), "Queries whose nearest shape")[1][2] == "3.off"
