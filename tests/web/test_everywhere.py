"""The web page for everybody: accessible, on every screen, in both themes, with and without WebGL, behind a prefix."""

from __future__ import annotations

from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from tests.support.server import Server
from tests.web.conftest import OpenPage, Watched, shape_id

VIEWS = ("library", "ask", "map", "evaluation", "shape", "flatten", "match")


def view_address(server: Server, view: str) -> str:
    part = f"/{shape_id(server, label='cat')}" if view in {"shape", "flatten", "match"} else ""
    if view == "match":
        part += f"/{shape_id(server, label='cat', order='newest')}"
    return f"{server.url}/#/{view}{part}"


def settled(page: Page, view: str) -> None:
    """Wait until a view shows what it is about."""
    shown = {
        "library": "li.card img[src]", "ask": ".drop", "map": ".classes-legend li", "evaluation": ".confusion .cell",
        "shape": ".ranked li", "flatten": ".stage canvas", "match": ".match canvas",
    }  # fmt: skip
    expect(page.locator(shown[view]).first).to_be_visible()
    if view == "shape":
        expect(page.locator(".stage canvas")).to_be_visible()


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("view", VIEWS)
def test_axe_finds_nothing_serious(filled: Server, open_page: OpenPage, view: str, dark: bool) -> None:
    # The page's content policy forbids the inline script of axe.
    page = open_page(view_address(filled, view), dark=dark, bypass_csp=True, reduced_motion="reduce")
    settled(page, view)
    found = Axe().run(page).response["violations"]
    serious = [
        (each["id"], [node["html"][:120] for node in each["nodes"]])
        for each in found
        if each["impact"] in {"serious", "critical"}
    ]
    assert serious == []


@pytest.mark.parametrize("width", [360, 2560])
@pytest.mark.parametrize("view", VIEWS)
def test_every_width_shows_everything(filled: Server, open_page: OpenPage, view: str, width: int) -> None:
    page = open_page(view_address(filled, view), width=width, height=740)
    settled(page, view)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width


def test_the_theme_is_remembered(filled: Server, open_page: OpenPage) -> None:
    page = open_page(filled.url)
    page.get_by_role("button", name="Theme").click()
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    page.reload()
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"


def test_the_form_of_the_api_documentation_sends_no_example_values(
    filled: Server, open_page: OpenPage, watched: Watched
) -> None:
    watched.expected = ("escaping deep link whitespace",)
    page = open_page(f"{filled.url}/docs#/shapes/upload_shape")
    page.get_by_role("button", name="Try it out").first.click()
    fields = page.locator(".opblock.is-open textarea, .opblock.is-open input[type=text]")
    expect(fields.nth(5)).to_be_visible()
    assert set(fields.evaluate_all("all => all.map(each => each.value.trim())")) == {"", "{}"}


def test_without_webgl_pictures_are_shown(filled: Server, open_page: OpenPage) -> None:
    page = open_page("about:blank")
    page.context.add_init_script(
        "const get = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {"
        "  return kind.startsWith('webgl') ? null : get.call(this, kind, ...rest); };"
    )
    page.goto(f"{filled.url}/#/shape/{shape_id(filled, label='cat')}?from=3&to=90")
    expect(page.locator("img.fallback")).to_be_visible()
    expect(page.get_by_text("does not draw in 3-D")).to_be_visible()
    expect(page.locator(".lengths b")).to_have_count(2)  # measuring works by numbers


def test_behind_a_path_prefix(tmp_path: Path, open_page: OpenPage) -> None:
    with Server(tmp_path / "prefixed", root_path="/tools/shapes") as server:
        for address in ("/tools/shapes", "/tools/shapes/"):
            page = open_page(server.url + address)
            expect(page.get_by_text("This library is empty")).to_be_visible()
            page.close()  # before the server, which the page would look for
