"""Which point is which, and parts against wholes, on the page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from tests.support.server import Server, stored
from tests.web.conftest import OpenPage, Watched, shape_id

MIDDLE = """canvas => {
  const copy = document.createElement('canvas');
  [copy.width, copy.height] = [canvas.clientWidth, canvas.clientHeight];
  const context = copy.getContext('2d');
  context.drawImage(canvas, 0, 0, copy.width, copy.height);
  const width = Math.floor(copy.width / 2);
  const { data } = context.getImageData(width, 0, width, copy.height);
  const inside = [];
  for (let y = 6; y < copy.height - 6; y++) for (let x = 6; x < width - 6; x++) {
    const solid = (i, j) => data[4 * ((y + j) * width + x + i) + 3] > 250;
    if (solid(0, 0) && solid(-5, 0) && solid(5, 0) && solid(0, -5) && solid(0, 5)) inside.push([x + width, y]);
  }
  return inside[Math.floor(inside.length / 2)];
}"""
"""A place within the surface in the right half of a canvas."""


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory, real_folder: Path, chromium: Browser) -> Iterator[Server]:
    """A server with two cats and a hand."""
    with Server(tmp_path_factory.mktemp("few"), parts=True) as server, server.http() as http:
        for name, path in zip(("tom", "felix"), sorted((real_folder / "cat").iterdir()), strict=False):
            stored(http, path.read_bytes(), file_name=f"{name}.off", label="cat")
        stored(http, min((real_folder / "hand").iterdir()).read_bytes(), file_name="palm.off", label="hand")
        yield server


def match_address(server: Server) -> str:
    return f"{server.url}/#/match/{shape_id(server, name='tom')}/{shape_id(server, name='felix')}"


def matched_file(server: Server) -> dict:
    job = httpx.get(f"{server.url}/v1/jobs", params={"kind": "file", "state": "succeeded"}).json()["items"][0]
    return httpx.get(f"{server.url}/v1/jobs/{job['id']}/file").json()


def test_a_point_is_shown_on_the_other_shape(few: Server, open_page: OpenPage) -> None:
    page = open_page(f"{few.url}/#/pair/{shape_id(few, name='tom')}/{shape_id(few, name='felix')}")
    page.get_by_role("link", name="Which point is which").click()
    canvas = page.locator(".match canvas")
    expect(canvas).to_be_visible()
    page.get_by_label("Vertex of tom").first.fill("40")
    page.keyboard.press("Enter")
    found = matched_file(few)
    weights = found["barycentric"][40]
    nearest = found["corners"][40][weights.index(max(weights))]
    words = page.locator(".match output")
    expect(words).to_contain_text(f"Vertex 40 of tom is at vertex {nearest} of felix.")
    expect(words).to_contain_text("Confidence")
    page.wait_for_timeout(500)  # the first frames
    x, y = canvas.evaluate(MIDDLE)
    canvas.click(position={"x": x, "y": y})  # on the second shape: the point of the first is shown
    expect(words).not_to_contain_text("Vertex 40 of tom")
    expect(words).to_contain_text(re.compile(r"Vertex \d+ of tom is at vertex \d+ of felix"))
    page.get_by_role("combobox", name="Colour").select_option("confidence")
    expect(page.locator(".match .legend")).to_be_visible()


def test_what_makes_a_match_doubtful_is_said(few: Server, open_page: OpenPage) -> None:
    page = open_page("about:blank")

    def doubtful(route: Route) -> None:
        found = route.fetch().json()
        found |= {"residual": 0.2, "oriented": False, "ambiguous": True}
        found["corners"] = [[-1] * 3 if row % 2 else each for row, each in enumerate(found["corners"])]
        route.fulfill(json=found)

    page.route(re.compile(r"/jobs/\w+/file"), doubtful)
    page.goto(match_address(few))
    expect(page.locator(".match .warning")).to_have_count(3)
    expect(page.locator(".match")).to_contain_text("left and right may be swapped")
    page.get_by_label("Vertex of tom").first.fill("41")
    page.get_by_role("button", name="Show its point").click()
    expect(page.locator(".match output")).to_contain_text("has no point on felix")


def test_a_match_is_cancelled_and_begun_again(few: Server, open_page: OpenPage) -> None:
    page = open_page("about:blank")
    polls = re.compile(r"/jobs/\w+\?wait=")
    page.route(polls, lambda _: None)  # the job never seems to end
    page.goto(match_address(few))
    with page.expect_request(lambda request: request.method == "DELETE" and "/jobs/" in request.url):
        page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_text("The match was cancelled")).to_be_visible()
    page.unroute_all(behavior="ignoreErrors")
    page.get_by_role("button", name="Match again").click()
    expect(page.locator(".match canvas")).to_be_visible()


def test_a_match_with_a_removed_shape_says_so(few: Server, open_page: OpenPage, watched: Watched) -> None:
    watched.expected = ("404",)
    page = open_page(f"{few.url}/#/match/{shape_id(few, name='tom')}/{'0' * 32}")
    expect(page.get_by_text("This could not be shown")).to_be_visible()


def cut_and_ask(page: Page, server: Server, share: str) -> None:
    page.goto(f"{server.url}/#/shape/{shape_id(server, name='tom')}?from=40")
    expect(page.get_by_text("Distances from vertex 40")).to_be_visible()
    expect(page.get_by_role("button", name="Ask with this patch")).to_be_disabled()
    page.get_by_label("Radius of the patch").fill(share)
    page.get_by_role("button", name="Ask with this patch").press("Enter")


def test_a_patch_finds_its_whole_and_the_place(few: Server, open_page: OpenPage) -> None:
    page = open_page("about:blank")
    cut_and_ask(page, few, "0.6")
    first = page.locator(".ranked li").first
    expect(first).to_contain_text("tom")
    expect(first.locator(".part")).to_contain_text(re.compile(r"Part of it, \d+ % of its area"))
    expect(page.get_by_label("Measure")).to_have_value("partial")
    expect(page.get_by_label("Classes by")).to_be_disabled()
    page.get_by_label("Measure").select_option("partial_any_scale")
    expect(page.locator(".ranked .part")).to_have_count(3)
    page.get_by_role("button", name="Match points of tom with the mesh").click()
    expect(page.get_by_role("dialog")).to_contain_text("Points are matched between two shapes of the library")
    page.get_by_role("button", name="Add and match").click()
    expect(page.locator(".match canvas")).to_be_visible()
    patch = shape_id(few, name="patch")
    assert page.url.endswith(f"/{patch}/{shape_id(few, name='tom')}")  # the part comes first
    page.goto(f"{few.url}/#/shape/{shape_id(few, name='felix')}?measure=partial")
    part = page.locator(".ranked li", has_text="patch").locator(".part")
    expect(part).to_contain_text("Contains it")
    httpx.delete(f"{few.url}/v1/shapes/{patch}").raise_for_status()
