"""A real browser at a real server. CI sets UNBEND_REQUIRE_BROWSER, so that nothing is skipped there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, Request, expect, sync_playwright

from tests.support.server import Server, stored
from unbend.api.routes.page import FOLDER

# Software rendering of WebGL: the same on every machine, with or without a graphics card.
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SECONDS = 60_000
expect.set_options(timeout=SECONDS)


def _missing(reason: str) -> None:
    if os.environ.get("UNBEND_REQUIRE_BROWSER"):
        pytest.fail(f"the browser tests are required here, but {reason}")
    pytest.skip(reason)


# Not for the session: Playwright's event loop would run on, and no other test could start one.
@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """Debian's Chromium, or another one on the path."""
    if not (FOLDER / "index.html").is_file():
        _missing("the package was installed without the page")
    path = os.environ.get("UNBEND_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        _missing("no chromium is installed")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield browser
        browser.close()


class Watched:
    """The complaints of a page: errors, warnings and failed requests."""

    def __init__(self) -> None:
        self.complaints: list[str] = []
        self.expected: tuple[str, ...] = ()
        """Parts of complaints that a test provokes."""

    def watch(self, page: Page) -> None:
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.complaints.append(f"uncaught: {error}"))
        page.on("requestfailed", self._failed)

    def _console(self, message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"} and "GPU stall" not in message.text:  # software WebGL says so
            self.complaints.append(f"{message.type}: {message.text}")

    def _failed(self, request: Request) -> None:
        if request.failure != "net::ERR_ABORTED":  # the page itself aborts what it no longer needs
            self.complaints.append(f"failed: {request.url} {request.failure}")

    def check(self) -> None:
        assert [each for each in self.complaints if not any(part in each for part in self.expected)] == []


OpenPage = Callable[..., Page]


@pytest.fixture
def watched() -> Watched:
    return Watched()


@pytest.fixture
def open_page(chromium: Browser, watched: Watched) -> Iterator[OpenPage]:
    """Open a page in a context of its own; afterwards any complaint of the browser fails the test."""
    contexts: list[BrowserContext] = []

    def open_at(url: str, *, width: int = 1280, height: int = 860, dark: bool = False, **options: object) -> Page:
        context = chromium.new_context(
            viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light", **options
        )
        context.set_default_timeout(SECONDS)
        contexts.append(context)
        page = context.new_page()
        watched.watch(page)
        page.on("filechooser", lambda _: None)  # a listener from the beginning, so that no chooser opens unnoticed
        page.goto(url)
        return page

    yield open_at
    for context in contexts:
        context.close()
    watched.check()


@pytest.fixture(scope="session")
def real_folder(tmp_path_factory: pytest.TempPathFactory, labelled: Callable) -> Path:
    """Real meshes in folders by class."""
    folder = tmp_path_factory.mktemp("meshes") / "animals"
    chosen: dict[str, int] = {}
    for path, row in labelled("shrec11_simplified"):
        name = row["class"]
        if name in {"ants", "cat", "hand"} and chosen.get(name, 0) < 4:
            chosen[name] = chosen.get(name, 0) + 1
            (folder / name).mkdir(parents=True, exist_ok=True)
            shutil.copy(path, folder / name)
    return folder


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory, real_folder: Path, chromium: Browser) -> Iterator[Server]:
    """A server with real shapes: all of the folder but the first of each class."""
    with Server(tmp_path_factory.mktemp("filled")) as server, server.http() as http:
        for path in sorted(real_folder.glob("*/*")):
            if path != min(path.parent.iterdir()):
                stored(http, path.read_bytes(), file_name=path.name, label=path.parent.name)
        yield server


def shape_id(server: Server, **query: str) -> str:
    return httpx.get(f"{server.url}/v1/shapes", params=query, timeout=60).json()["items"][0]["id"]
