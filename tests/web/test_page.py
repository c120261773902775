"""The web page in a real browser at a real server, mostly with real meshes."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser, Locator, Page, Route, expect

from tests.support.server import DAMAGED, Server, small_mesh, stored
from tests.web.conftest import OpenPage, Watched, shape_id
from unbend.library import Library
from unbend.mesh.shapes import sheet
from unbend.mesh.write import write_mesh

PAINTED = """canvas => {
  const copy = document.createElement('canvas');
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const context = copy.getContext('2d');
  context.drawImage(canvas, 0, 0);
  const { data } = context.getImageData(0, 0, copy.width, copy.height);
  const halves = [new Set(), new Set()];
  const counts = [0, 0];
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] < 200) continue;
    const half = (i / 4) % copy.width < copy.width / 2 ? 0 : 1;
    counts[half] += 1;
    halves[half].add(`${data[i]} ${data[i + 1]} ${data[i + 2]}`);
  }
  return { share: counts.map(count => count / (copy.width * copy.height / 2)), colours: halves.map(half => half.size) };
}"""
"""The share of opaque pixels in the left and right half of a canvas, and the number of their colours."""

BROKEN_IMAGES = "() => [...document.images].filter(each => each.complete && each.src && !each.naturalWidth).length"


@pytest.fixture
def empty(tmp_path: Path, chromium: Browser) -> Server:
    with Server(tmp_path / "empty") as server:
        yield server


@pytest.fixture(scope="module")
def unused(tmp_path_factory: pytest.TempPathFactory, chromium: Browser) -> Server:
    """A server in which no test stores a shape."""
    with Server(tmp_path_factory.mktemp("unused"), workers=1) as server:
        yield server


def choose(page: Page, button: str, files: object) -> None:
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name=button).first.click()
    chooser.value.set_files(files)


def first_file(folder: Path, label: str) -> Path:
    return min((folder / label).iterdir())


def test_a_folder_is_uploaded_labelled_and_drawn(empty: Server, open_page: OpenPage, real_folder: Path) -> None:
    page = open_page(empty.url)
    expect(page.get_by_text("This library is empty")).to_be_visible()
    choose(page, "Add a folder", real_folder)
    expect(page.get_by_role("dialog")).to_contain_text("ants (4), cat (4), hand (4)")
    page.get_by_role("button", name="Add", exact=True).click()
    expect(page.get_by_text("12 of 12 uploads done")).to_be_visible()
    expect(page.get_by_text("12 shapes", exact=True)).to_be_visible()
    expect(page.locator("select[aria-label=Class]")).to_contain_text("cat (4)")
    expect(page.locator("li.card img[src]")).to_have_count(12)
    assert page.evaluate(BROKEN_IMAGES) == 0
    expect(page.locator(".panel details")).not_to_have_attribute("open", "")  # makes room once all is done
    page.locator(".panel summary").click()
    names = [path.name for label in ("ants", "cat", "hand") for path in sorted((real_folder / label).iterdir())]
    assert [Path(name).stem for name in page.locator(".jobs li").locator("a").all_inner_texts()] == [
        Path(name).stem for name in names
    ]
    labels = [shape["label"] for shape in httpx.get(f"{empty.url}/v1/shapes").json()["items"]]
    assert sorted(labels) == sorted(["ants", "cat", "hand"] * 4)


def test_a_file_that_fails_says_why(unused: Server, open_page: OpenPage, tmp_path: Path) -> None:
    page = open_page(unused.url)
    damaged = tmp_path / "damaged.off"
    damaged.write_bytes(DAMAGED)
    choose(page, "Add files", damaged)
    page.get_by_role("button", name="Add", exact=True).click()
    expect(page.get_by_text("0 of 1 upload done, 1 failed")).to_be_visible()
    expect(page.locator(".jobs .error")).to_contain_text(re.compile(r"line|end|file", re.IGNORECASE))
    expect(page.locator(".jobs .error")).to_be_visible()  # the panel stays open for messages


def test_other_files_are_named_and_not_sent(unused: Server, open_page: OpenPage, tmp_path: Path) -> None:
    page = open_page(unused.url)
    notes = tmp_path / "notes.txt"
    notes.write_text("no mesh")
    choose(page, "Add files", notes)
    expect(page.get_by_text("None of these files is a mesh")).to_be_visible()


def test_one_click_loads_the_demo(empty: Server, open_page: OpenPage) -> None:
    page = open_page(empty.url)
    page.get_by_role("button", name="Load the demo shapes").click()
    expect(page.locator("li.card").first).to_be_visible()
    expect(page.locator("li.card img[src]").first).to_be_visible()


def test_surface_and_signature_are_drawn(filled: Server, open_page: OpenPage) -> None:
    page = open_page(f"{filled.url}/#/shape/{shape_id(filled, label='cat')}")
    canvas = page.locator(".stage canvas")
    expect(canvas).to_be_visible()
    page.wait_for_function(f"() => ({PAINTED})(document.querySelector('.stage canvas')).colours[1] > 50")
    painted = canvas.evaluate(PAINTED)
    assert all(0.03 < share < 0.9 for share in painted["share"])
    expect(page.locator("dd", has_text="Least squares")).to_be_visible()
    assert all(colours > 50 for colours in painted["colours"])  # shaded, not one flat colour


def test_the_slider_bends_the_surface(filled: Server, open_page: OpenPage) -> None:
    page = open_page(f"{filled.url}/#/shape/{shape_id(filled, label='cat')}")
    canvas = page.locator(".stage canvas")
    expect(canvas).to_be_visible()
    page.wait_for_function(f"() => ({PAINTED})(document.querySelector('.stage canvas')).colours[1] > 50")
    before = canvas.evaluate("canvas => canvas.toDataURL()")
    page.get_by_label("Bend the surface into its signature").fill("1")
    page.wait_for_function("before => document.querySelector('.stage canvas').toDataURL() !== before", arg=before)
    share = canvas.evaluate(PAINTED)["share"]
    assert share[0] == pytest.approx(share[1], rel=0.05)  # both halves now show the signature


def test_a_moving_camera_draws_drafts_until_it_rests(filled: Server, open_page: OpenPage) -> None:
    # Four times the pixels: too many for software rendering to draw them all while the camera moves, on any machine.
    page = open_page(f"{filled.url}/#/shape/{shape_id(filled, label='cat')}", device_scale_factor=2)
    canvas = page.locator(".stage canvas")
    expect(canvas).to_be_visible()
    page.wait_for_function(f"() => ({PAINTED})(document.querySelector('.stage canvas')).colours[1] > 50")
    whole = canvas.evaluate(
        """canvas => {
          globalThis.widths = [];
          new MutationObserver(() => widths.push(canvas.width)).observe(canvas, { attributeFilter: ["width"] });
          return canvas.width;
        }"""
    )
    canvas.focus()
    for _ in range(100):
        page.keyboard.press("ArrowRight")
        page.wait_for_timeout(100)
        if page.evaluate("whole => Math.min(...widths) < whole", whole):
            break
    page.wait_for_function("whole => widths.at(-1) === whole", arg=whole)
    assert page.evaluate("Math.min(...widths)") < whole
    painted = canvas.evaluate(PAINTED)
    assert all(colours > 50 for colours in painted["colours"])


def test_two_clicks_give_a_path_with_the_lengths_of_the_api(filled: Server, open_page: OpenPage) -> None:
    shape = shape_id(filled, label="cat")
    page = open_page(f"{filled.url}/#/shape/{shape}")
    canvas = page.locator(".stage canvas")
    expect(canvas).to_be_visible()
    page.wait_for_function(f"() => ({PAINTED})(document.querySelector('.stage canvas')).colours[1] > 50")
    places = canvas.evaluate(
        """canvas => {
          const copy = document.createElement('canvas');
          [copy.width, copy.height] = [canvas.clientWidth, canvas.clientHeight];
          const context = copy.getContext('2d');
          context.drawImage(canvas, 0, 0, copy.width, copy.height);
          const width = Math.floor(copy.width / 2);
          const { data } = context.getImageData(0, 0, width, copy.height);
          const inside = [];
          for (let y = 4; y < copy.height - 4; y++) for (let x = 4; x < width - 4; x++) {
            const solid = (i, j) => data[4 * ((y + j) * width + x + i) + 3] > 250;
            if (solid(0, 0) && solid(-4, 0) && solid(4, 0) && solid(0, -4) && solid(0, 4)) inside.push([x, y]);
          }
          inside.sort((a, b) => a[0] - b[0]);
          return [inside[Math.floor(inside.length * 0.05)], inside[Math.floor(inside.length * 0.9)]];
        }"""
    )
    (ax, ay), (bx, by) = places
    canvas.click(position={"x": ax, "y": ay})
    expect(page.get_by_text("Choose another point for the shortest path")).to_be_visible()
    canvas.click(position={"x": bx, "y": by})
    expect(page.locator(".lengths b")).to_have_count(2)
    source, target = (int(page.get_by_label(name).input_value()) for name in ("First vertex", "Second vertex"))
    assert source != target
    shown = [float(each) for each in page.locator(".lengths b").evaluate_all("all => all.map(e => e.dataset.length)")]
    query = {"source": source, "target": target}
    found = httpx.get(f"{filled.url}/v1/shapes/{shape}/geodesics", params=query, timeout=60).json()
    path = np.array(found["path"])
    assert shown[0] == pytest.approx(found["length"])
    assert shown[0] == pytest.approx(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    query = {"format": "json", "whole": True}
    form = httpx.get(f"{filled.url}/v1/shapes/{shape}/signature", params=query, timeout=60).json()
    points = np.array(form["points"])
    signature = httpx.get(f"{filled.url}/v1/shapes/{shape}/signature", timeout=60).json()
    straight = np.linalg.norm(points[source] - points[target]) * signature["scale"]
    assert shown[1] == pytest.approx(straight, rel=1e-4)


def test_distances_and_a_patch_by_numbers(filled: Server, open_page: OpenPage) -> None:
    page = open_page(f"{filled.url}/#/shape/{shape_id(filled, label='hand')}")
    page.get_by_label("First vertex").fill("7")
    page.get_by_role("button", name="Measure").click()
    expect(page.get_by_text("Distances from vertex 7")).to_be_visible()
    page.get_by_label("Radius of the patch").fill("0.5")
    expect(page.get_by_text(re.compile(r"radius .*% of the area"))).to_be_visible()


def test_a_query_finds_the_right_class(filled: Server, open_page: OpenPage, real_folder: Path) -> None:
    page = open_page(f"{filled.url}/#/ask")
    choose(page, "Choose a mesh", first_file(real_folder, "cat"))
    expect(page.locator(".verdict strong")).to_have_text("cat")
    expect(page.locator(".verdict")).to_contain_text("near enough to this class")
    expect(page.locator(".ranked li").first).to_contain_text("cat")
    expect(page.locator(".portrait canvas")).to_be_visible()
    page.wait_for_function(f"() => ({PAINTED})(document.querySelector('.portrait canvas')).colours[0] > 50")
    page.get_by_role("button", name=re.compile("Match points of")).first.click()
    expect(page.get_by_role("dialog").get_by_label("Class")).to_have_value("cat")
    expect(page.get_by_role("dialog")).to_contain_text("stores it in the library")
    page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    page.get_by_label("Measure").select_option("moments")
    expect(page.locator(".ranked li")).to_have_count(9)
    page.get_by_role("button", name=re.compile("with the mesh")).first.click()
    expect(page.locator(".comparison canvas")).to_be_visible()
    page.wait_for_function(f"() => ({PAINTED})(document.querySelector('.comparison canvas')).colours[1] > 50")
    assert len(httpx.get(f"{filled.url}/v1/shapes", params={"limit": 500}).json()["items"]) == 9  # not stored


def test_a_strange_mesh_is_unknown(filled: Server, open_page: OpenPage, tmp_path: Path) -> None:
    flat = sheet()
    file = tmp_path / "sheet.ply"
    file.write_bytes(write_mesh(flat.vertices, flat.faces, "ply"))
    page = open_page(f"{filled.url}/#/ask")
    choose(page, "Choose a mesh", file)
    expect(page.locator(".verdict strong")).to_have_text("Unknown")
    expect(page.locator(".verdict")).to_contain_text("too far from the nearest class")


def test_a_picture_on_its_way_has_a_placeholder(filled: Server, open_page: OpenPage) -> None:
    page = open_page("about:blank")
    page.route(re.compile(r"/v1/shapes/\w+/thumbnail"), lambda _: None)  # never answered
    page.goto(filled.url)
    frame = page.locator("li.card .thumbnail").first
    expect(frame).to_be_visible()
    assert "drawing" in frame.evaluate("(element) => getComputedStyle(element, '::after').content")


def test_an_answer_without_shapes_says_why(unused: Server, open_page: OpenPage, tmp_path: Path) -> None:
    # Through the page's own words; the library's sentence is tested with the library.
    flat = sheet()
    file = tmp_path / "sheet.ply"
    file.write_bytes(write_mesh(flat.vertices, flat.faces, "ply"))
    page = open_page(f"{unused.url}/#/ask")
    reason = {"measure": "spectrum", "classes": [], "shapes": [], "known": None, "warnings": ["ask with `samples`"]}
    page.route("**/queries", lambda route: route.fulfill(json=reason))
    choose(page, "Choose a mesh", file)
    expect(page.locator(".verdict")).to_have_text("The library has nothing to compare this mesh with.")
    expect(page.locator(".warning code")).to_have_text("samples")
    expect(page.locator(".warning")).to_have_text("ask with samples")


def test_two_shapes_beside_each_other(filled: Server, open_page: OpenPage) -> None:
    page = open_page(f"{filled.url}/#/shape/{shape_id(filled, label='cat')}")
    page.get_by_role("link", name=re.compile("Compare with")).first.click()
    expect(page.locator(".pair canvas")).to_be_visible()
    page.wait_for_function(f"() => ({PAINTED})(document.querySelector('.pair canvas')).colours[0] > 50")
    page.go_back()
    expect(page.locator(".nearest")).to_be_visible()


@pytest.mark.parametrize("dimensions", ["2", "3"])
def test_the_map_shows_the_shapes(filled: Server, open_page: OpenPage, dimensions: str) -> None:
    page = open_page(f"{filled.url}/#/map?dimensions={dimensions}")
    canvas = page.locator(".canvas canvas").first
    expect(canvas).to_be_visible()
    expect(page.get_by_text("9 shapes.")).to_be_visible()
    page.wait_for_function(f"() => ({PAINTED})(document.querySelector('.canvas canvas')).share[0] > 0")
    expect(page.locator(".classes-legend li")).to_have_count(3)
    place = canvas.evaluate(
        """canvas => {
          const context = canvas.getContext('2d');
          const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
          for (let i = 3; i < data.length; i += 4) {
            if (data[i] > 250) return [(i >> 2) % canvas.width, Math.floor((i >> 2) / canvas.width)];
          }
        }"""
    )
    ratio = page.evaluate("devicePixelRatio")
    canvas.hover(position={"x": place[0] / ratio, "y": place[1] / ratio + 3})
    expect(page.locator(".hover").first).to_be_visible()
    canvas.click(position={"x": place[0] / ratio, "y": place[1] / ratio + 3})
    expect(page.locator(".shape")).to_be_visible()


def test_a_lasso_selects_on_the_map(filled: Server, open_page: OpenPage) -> None:
    page = open_page(f"{filled.url}/#/map")
    canvas = page.locator(".canvas canvas").first
    expect(canvas).to_be_visible()
    page.wait_for_function(f"() => ({PAINTED})(document.querySelector('.canvas canvas')).share[0] > 0")
    box = canvas.bounding_box()
    corners = [(4, 4), (box["width"] - 4, 4), (box["width"] - 4, box["height"] - 4), (4, box["height"] - 4)]
    page.keyboard.down("Shift")
    page.mouse.move(box["x"] + corners[0][0], box["y"] + corners[0][1])
    page.mouse.down()
    for x, y in corners[1:]:
        page.mouse.move(box["x"] + x, box["y"] + y, steps=8)
    page.mouse.up()
    page.keyboard.up("Shift")
    expect(page.get_by_text("9 shapes selected")).to_be_visible()


def test_the_evaluation_shows_metrics_and_mistakes(filled: Server, open_page: OpenPage) -> None:
    page = open_page(f"{filled.url}/#/evaluation")
    expect(page.locator(".confusion .cell").first).to_be_visible()
    expect(page.locator(".metrics tbody tr")).to_have_count(6)
    expect(page.get_by_role("columnheader", name="E-measure")).to_have_attribute("title", re.compile("cannot reach 1"))
    right = httpx.get(f"{filled.url}/v1/evaluation", timeout=60).json()
    assert f"{100 * right['accuracy']:.1f} %" in page.locator(".details").inner_text()
    page.locator(".confusion .cell").first.click()
    expect(page.locator(".mistakes li").first).to_be_visible()


def test_a_sheet_is_flattened(empty: Server, open_page: OpenPage) -> None:
    flat = sheet()
    with empty.http() as http:
        stored(http, write_mesh(flat.vertices, flat.faces, "ply"))
    page = open_page(f"{empty.url}/#/flatten/{shape_id(empty)}")
    expect(page.locator(".stage canvas")).to_be_visible()
    expect(page.get_by_text("Mean distortion of edges")).to_be_visible()
    page.get_by_label("Texture").select_option("stretch")
    assert "folds over itself" not in page.locator(".flatten").inner_text()


def test_a_new_class_survives_a_reload_and_can_be_undone(filled: Server, open_page: OpenPage) -> None:
    shape = shape_id(filled, label="hand")
    page = open_page(f"{filled.url}/#/shape/{shape}")
    page.get_by_label("Class").fill("glove")
    page.get_by_label("Class").press("Enter")
    expect(page.get_by_text("Saved.")).to_be_visible()
    page.reload()
    expect(page.get_by_label("Class")).to_have_value("glove")
    page.get_by_label("Class").fill("hand")
    page.get_by_label("Class").press("Enter")
    page.get_by_role("button", name="Undo").click()
    expect(page.get_by_label("Class")).to_have_value("glove")
    page.get_by_label("Class").fill("hand")
    page.get_by_label("Class").press("Enter")
    page.wait_for_function(
        f"async () => (await (await fetch('/v1/shapes/{shape}')).json()).label === 'hand'", polling=200
    )


def test_shapes_are_renamed_selected_removed_and_brought_back(filled: Server, open_page: OpenPage) -> None:
    page = open_page(filled.url)
    expect(page.get_by_text("9 shapes", exact=True)).to_be_visible()
    page.get_by_role("button", name=re.compile("Edit the name")).first.click()
    page.get_by_label("Name", exact=True).fill("renamed")
    page.get_by_label("Name", exact=True).press("Enter")
    expect(page.locator("li.card", has_text="renamed")).to_be_visible()
    page.get_by_role("button", name="Undo").click()
    expect(page.locator("li.card", has_text="renamed")).to_have_count(0)
    page.get_by_role("checkbox", name=re.compile("Select ")).nth(0).check()
    page.get_by_role("checkbox", name=re.compile("Select ")).nth(1).check()
    expect(page.get_by_text("2 selected")).to_be_visible()
    page.get_by_role("button", name="Remove").click()
    expect(page.get_by_text("7 shapes", exact=True)).to_be_visible()
    page.get_by_role("button", name="Undo").last.click()
    expect(page.get_by_text("9 shapes", exact=True)).to_be_visible()
    page.reload()
    expect(page.get_by_text("9 shapes", exact=True)).to_be_visible()


def test_a_removal_reaches_the_server(empty: Server, open_page: OpenPage) -> None:
    with empty.http() as http:
        stored(http, small_mesh(1), file_name="ring.ply")
    page = open_page(empty.url)
    page.get_by_role("checkbox", name="Select ring").check()
    page.get_by_role("button", name="Remove").click()
    expect(page.get_by_text("This library is empty")).to_be_visible()
    page.close()  # the time to undo is not over: the page removes the shape when it closes
    with empty.http() as http:
        for _ in range(100):
            if not http.get("/v1/shapes").json()["items"]:
                return
        pytest.fail("the shape is still there")


def test_search_class_and_order(filled: Server, open_page: OpenPage) -> None:
    page = open_page(filled.url)
    expect(page.get_by_text("9 shapes", exact=True)).to_be_visible()
    page.locator("select[aria-label=Class]").select_option("=cat")
    expect(page.get_by_text("3 of 9 shapes")).to_be_visible()
    page.get_by_label("Order").select_option("name")
    names = page.locator("li.card a.name").all_inner_texts()
    page.get_by_label("Search by name").fill(names[0])
    expect(page.get_by_text("1 of 9 shapes")).to_be_visible()
    page.reload()  # the address remembers all three
    expect(page.get_by_text("1 of 9 shapes")).to_be_visible()


def tab_to(page: Page, name: str) -> None:
    for _ in range(60):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.textContent") == name:
            return
    pytest.fail(f"the keyboard does not reach {name!r}")


def test_upload_and_query_by_keyboard(empty: Server, open_page: OpenPage, real_folder: Path) -> None:
    page = open_page(empty.url)
    expect(page.get_by_text("This library is empty")).to_be_visible()
    tab_to(page, "Add files")
    with page.expect_file_chooser() as chooser:
        page.keyboard.press("Enter")
    chooser.value.set_files([str(path) for path in sorted((real_folder / "hand").iterdir())[1:]])
    expect(page.get_by_role("dialog")).to_be_visible()
    page.keyboard.press("Tab")
    for _ in range(20):
        if page.evaluate("document.activeElement.textContent") == "Add":
            break
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    expect(page.get_by_text("3 of 3 uploads done")).to_be_visible()
    tab_to(page, "Ask")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="What is this?")).to_be_visible()
    tab_to(page, "Choose a mesh")
    with page.expect_file_chooser() as chooser:
        page.keyboard.press("Enter")
    chooser.value.set_files(str(first_file(real_folder, "hand")))
    expect(page.locator(".ranked li")).to_have_count(3)


@pytest.fixture
def keyed(tmp_path: Path) -> Iterator[tuple[Server, str]]:
    """A server with one shape that needs a key, and a key that may only read."""
    with Library(str(tmp_path / "library.db")) as library:
        library.add(small_mesh(2), name="ring")
        _, secret = library.keys.create("reader", "read")
    with Server(tmp_path) as server:
        yield server, secret


def fill_in_key(page: Page, secret: str) -> Locator:
    """Fill in the key that the page asks for; return the button that uses it."""
    expect(page.get_by_role("dialog")).to_contain_text("API key")
    page.get_by_label("Key", exact=True).fill(secret)
    return page.get_by_role("button", name="Use")


def test_keys_are_asked_for_and_their_limits_said(
    keyed: tuple[Server, str], open_page: OpenPage, watched: Watched
) -> None:
    watched.expected = ("401", "403")
    server, secret = keyed
    page = open_page(server.url)
    fill_in_key(page, secret).click()
    expect(page.locator("li.card img[src]")).to_have_count(1)
    page.get_by_role("button", name=re.compile("Edit the name")).click()
    page.get_by_label("Name", exact=True).fill("other")
    page.get_by_label("Name", exact=True).press("Enter")
    expect(page.locator(".notice.error")).to_contain_text("may only read")
    page.reload()  # the session keeps the key
    expect(page.locator("li.card img[src]")).to_have_count(1)
    assert page.evaluate("() => JSON.stringify(localStorage)").find(secret) < 0


def test_a_late_refusal_of_a_request_without_a_key_leaves_the_new_key(
    keyed: tuple[Server, str], open_page: OpenPage, watched: Watched
) -> None:
    watched.expected = ("401",)
    server, secret = keyed
    page = open_page("about:blank")
    held: list[Route] = []
    page.route("**/v1/classes", lambda route: held.append(route))  # noqa: PLW0108  Playwright marks it
    page.goto(server.url)
    use = fill_in_key(page, secret)
    with page.expect_request("**/v1/classes"):
        use.click()
    for _ in range(100):
        if len(held) < 2:
            page.wait_for_timeout(100)  # a request is seen before it is held
    early, late = held
    with page.expect_response("**/v1/classes"):
        early.continue_()
    late.continue_()
    page.unroute("**/v1/classes")
    expect(page.locator("li.card img[src]")).to_have_count(1)
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.reload()
    expect(page.locator("li.card img[src]")).to_have_count(1)


def test_a_server_that_is_killed_comes_back_under_the_page(
    tmp_path: Path, open_page: OpenPage, watched: Watched
) -> None:
    watched.expected = (
        "ERR_CONNECTION_REFUSED", "ERR_INCOMPLETE_CHUNKED", "ERR_CONNECTION_RESET", "ERR_SOCKET_NOT_CONNECTED",
        "ERR_EMPTY", "503",
    )  # fmt: skip
    folder = tmp_path / "killed"
    with Server(folder) as first:
        with first.http() as http:
            stored(http, small_mesh(3), file_name="ring.ply")
        page = open_page(first.url)
        expect(page.locator("li.card")).to_have_count(1)
        page.wait_for_timeout(1500)  # the stream of jobs is open
        held: list[Route] = []
        page.route("**/v1/jobs/events", lambda route: held.append(route))  # noqa: PLW0108  Playwright marks it
        first.kill()
        expect(page.locator(".banner")).to_be_visible()
    with Server(folder, port=int(first.url.rpartition(":")[2])) as second:
        expect(page.locator(".banner")).to_be_hidden()
        expect(page.locator("li.card")).to_have_count(1)
        with second.http() as http:
            stored(http, small_mesh(4), file_name="more.ply")
            for each in held:
                each.continue_()
            page.unroute("**/v1/jobs/events")
            expect(page.locator("li.card")).to_have_count(2)  # which no event announced
            stored(http, small_mesh(5), file_name="most.ply")
        expect(page.locator("li.card")).to_have_count(3)  # the stream is followed again


def test_a_view_is_a_glb_file_with_the_form(filled: Server, shared_data: Path) -> None:
    data = httpx.get(f"{filled.url}/v1/shapes/{shape_id(filled, label='cat')}/view", timeout=60).content
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))


def test_the_grid_holds_only_what_is_visible(unused: Server, open_page: OpenPage) -> None:
    """With 3000 shapes the document has fewer than 80 cards at a time, and scrolling reaches the last shape."""
    shapes = [
        {
            "id": f"{number:032x}", "name": f"shape {number}", "label": None, "metadata": {}, "warnings": [],
        }
        for number in range(3000)
    ]  # fmt: skip
    page = open_page("about:blank")
    page.route(
        re.compile(r"/v1/shapes\?"),
        lambda route: route.fulfill(json={"items": shapes, "next_cursor": None}),
    )
    page.route(re.compile(r"/thumbnail(\?|$)"), lambda route: route.fulfill(body=b"", content_type="image/webp"))
    page.goto(unused.url)
    expect(page.get_by_text("3,000 shapes")).to_be_visible()
    assert page.locator("li.card").count() < 80
    page.evaluate("() => scrollTo(0, document.body.scrollHeight)")
    expect(page.locator("li.card a.name", has_text=re.compile("^shape 2999$"))).to_be_visible()
    assert page.locator("li.card").count() < 80
