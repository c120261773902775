"""Chromium with software WebGL."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, Page, sync_playwright

ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Software rendering of WebGL, as in the tests of the page."""
MILLISECONDS = 300_000
"""Longest wait for anything on a page, on a machine that other work keeps busy."""


@contextmanager
def chromium() -> Iterator[Browser]:
    path = os.environ.get("UNBEND_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield browser
        browser.close()


@contextmanager
def fresh_page(browser: Browser, *, width: int = 1280, height: int = 860, dark: bool = False) -> Iterator[Page]:
    """Open an empty page in a new context, whose caches are empty."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light", reduced_motion="reduce"
    )
    context.set_default_timeout(MILLISECONDS)
    yield context.new_page()
    context.close()
