"""The web page in Chromium: time to the first cards beside only loading the same bytes, script sizes, and frames.

    python -m benchmarks.web.page

Makes a library of 600 shapes (meshes of SHREC'11), and opens the page in new browser contexts, in turns with a static
page of the same files. Then it turns a torus of 500,000 faces, and scrolls a mocked list of 20,000 shapes. WebGL runs
in software. Writes the section "page" of docs/benchmarks/page.md.
"""

from __future__ import annotations

import base64
import gzip
import os
import re
import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
from playwright.sync_api import Browser, Page, Route

from benchmarks.common import BENCHMARKS, ROOT, table, write_section
from benchmarks.retrieval.data import listed
from benchmarks.web.browser import chromium, fresh_page
from tests.support.server import Server, ply, stored
from unbend import Parameters, Surface, read_mesh
from unbend.api.routes.page import FOLDER
from unbend.library import Library
from unbend.mesh.shapes import torus
from unbend.threads import available_cores

SHAPES = 600
SAMPLES = 40
TURNS = 7
COLD_TURNS = 3
SECONDS = 5
LONG_FRAME = 50
GRID_SHAPES = 20_000
GRID_SPEEDS = {"as a wheel does": 3000, "as a dragged scroll bar does": 150_000}
"""Pixels a second."""
COLUMNS = 500
"""Cells around the torus in both directions; each has two faces."""

WATCH = """
globalThis.marks = {};
const mark = (name) => (globalThis.marks[name] ??= performance.now());
new MutationObserver(() => document.querySelector("li.card") && mark("cards"))
  .observe(document, { childList: true, subtree: true });
const isDrawn = (card) => {
  const { top, bottom } = card.getBoundingClientRect();
  const image = card.querySelector("img");
  return bottom <= 0 || top >= innerHeight || (image.complete && image.naturalWidth > 0);
};
const look = () => {
  const cards = [...document.querySelectorAll("li.card")];
  if (cards.length && cards.every(isDrawn)) mark("pictures");
  else requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
"""Note when the first cards are in the document, and when the pictures of all visible ones are drawn."""

PAINT = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime"
LOADED = "performance.getEntriesByType('resource').map(({ name }) => name)"
LAST_BYTE = "Math.max(...performance.getEntriesByType('resource').map(({ responseEnd }) => responseEnd))"

SHOWN = """
const shown = () => {
  const viewer = document.querySelector(".stage")?.viewer;
  if (!viewer?.frames) return requestAnimationFrame(shown);
  viewer.settle();
  globalThis.shown = performance.now();
};
requestAnimationFrame(shown);
"""
"""Note when the viewer has drawn its first frame."""

SPIN = """async (milliseconds) => {
  const { viewer } = document.querySelector(".stage");
  const drawn = () => ({
    faces: viewer.panes.reduce((sum, { mesh }) => sum + mesh.geometry.index.count / 3, 0),
    pixels: viewer.canvas.width * viewer.canvas.height,
  });
  const still = drawn();
  const begin = performance.now();
  let frames = 0;
  while (performance.now() - begin < milliseconds) {
    viewer.spin();
    await new Promise(requestAnimationFrame);
    viewer.settle();
    frames++;
  }
  return { still, turning: drawn(), rate: (1000 * frames) / (performance.now() - begin) };
}"""
"""Turn the camera in each frame that the browser offers, and describe a frame before and at the end."""

ONE_PICTURE = """
const bytes = Uint8Array.from(atob(globalThis.picture), (byte) => byte.charCodeAt(0));
const blob = new Blob([bytes], { type: "image/webp" });
const send = globalThis.fetch;
globalThis.fetch = (address, ...rest) =>
  /thumbnail/.test(address) ? Promise.resolve(new Response(blob)) : send(address, ...rest);
"""
"""Answer requests of thumbnails within the page, because a request to this program takes longer than to a server."""

SCROLL = """async ([milliseconds, speed]) => {
  scrollTo(0, 0);
  await new Promise(requestAnimationFrame);
  const begin = performance.now();
  const frames = [];
  let before = begin;
  while (before - begin < milliseconds) {
    await new Promise(requestAnimationFrame);
    const now = performance.now();
    frames.push(now - before);
    before = now;
    scrollTo(0, (speed * (now - begin)) / 1000);
  }
  return { frames, cards: document.querySelectorAll("li.card").length };
}"""
"""Scroll down, and return the milliseconds between frames."""


def main() -> None:
    with TemporaryDirectory(prefix="unbend-page-") as temporary, chromium() as browser:
        folder = Path(temporary)
        fill(folder / "many")
        start = start_table(browser, folder)
        with Server(folder / "large", call_seconds=300) as server:
            models = model_rows(browser, server)
            grid = [grid_row(browser, server.url, GRID_SHAPES, *each) for each in GRID_SPEEDS.items()]
        with Server(folder / "many") as server:
            grid += [grid_row(browser, server.url, SHAPES, "as a wheel does", GRID_SPEEDS["as a wheel does"])]
        version = browser.version
    write_section(BENCHMARKS / "page.md", "page", text(version, start, models, grid))


def fill(folder: Path) -> None:
    """Make a library of 600 shapes: real meshes, and some of them again with small errors."""
    folder.mkdir()
    paths, labels = listed("shrec11_simplified")
    random = np.random.default_rng(1)
    with Library(str(folder / "library.db")) as library:
        for number in range(SHAPES):
            path, label = paths[number % len(paths)], labels[number % len(paths)]
            data: Path | bytes = path
            if number >= len(paths):
                surface = read_mesh(path)
                size = 0.002 * np.ptp(surface.vertices)
                data = ply(Surface(surface.vertices + random.normal(0, size, surface.vertices.shape), surface.faces))
            library.add(data, name=f"{path.stem}-{number}", label=label, parameters=Parameters(samples=SAMPLES))


# Time to the first cards.


def start_table(browser: Browser, folder: Path) -> str:
    """Open the page and its static peers in turns."""
    cold = [cold_start(browser, folder / "many") for _ in range(COLD_TURNS)]
    taken: dict[str, list[dict[str, float]]] = {"page": [], "bytes": [], "pictures": []}
    with Server(folder / "many") as server:
        loaded = open_library(browser, server.url)[1]
        peers = folder / "peers"
        save_peers(peers, loaded)
        with bare_server(peers) as url:
            for _ in range(TURNS):
                taken["page"].append(open_library(browser, server.url)[0])
                taken["bytes"].append(open_static(browser, f"{url}/bytes.html"))
                taken["pictures"].append(open_static(browser, f"{url}/pictures.html"))

    def row(name: str, mark: str, peer: str, peer_mark: str) -> list[str]:
        ours, theirs = median(taken["page"], mark), median(taken[peer], peer_mark)
        first = f"{median(cold, mark):.0f} ms"
        return [name, first, f"{ours:.0f} ms", f"{theirs:.0f} ms", f"{ours / theirs:.1f}"]

    header = ["until", "new server", "running server", "only the same bytes", "ratio"]
    rows = [
        row("first contentful paint", "paint", "bytes", "paint"),
        row("first cards in the document", "cards", "bytes", "bytes"),
        row("pictures of all visible cards", "pictures", "pictures", "bytes"),
    ]
    return table(header, rows)


def cold_start(browser: Browser, folder: Path) -> dict[str, float]:
    """Open the page at a server that has drawn no picture yet."""
    with Server(folder) as server:
        return open_library(browser, server.url)[0]


def open_library(browser: Browser, url: str) -> tuple[dict[str, float], list[str]]:
    """Return the times of a new page in milliseconds, and the addresses that it read."""
    with fresh_page(browser) as page:
        page.add_init_script(WATCH)
        page.goto(url)
        page.wait_for_function("() => globalThis.marks.pictures")
        return page.evaluate("globalThis.marks") | {"paint": page.evaluate(PAINT)}, page.evaluate(LOADED)


def open_static(browser: Browser, url: str) -> dict[str, float]:
    with fresh_page(browser) as page:
        page.goto(url)  # which waits for the event "load"
        page.wait_for_function(f"() => {PAINT}")
        return {"paint": page.evaluate(PAINT), "bytes": page.evaluate(LAST_BYTE)}


def save_peers(folder: Path, loaded: list[str]) -> None:
    """Save two static pages: one of the scripts, styles and first list, one also of the pictures."""
    folder.mkdir()
    head, pictures = "", ""
    for number, address in enumerate(loaded):
        place = urlsplit(address)
        suffix = Path(place.path).suffix
        if "/assets/" in place.path and suffix in {".js", ".css"}:
            name = Path(place.path).name
            kind = 'rel="stylesheet"' if suffix == ".css" else 'rel="preload" as="script"'
            head += f'<link {kind} href="{name}">'
        elif place.path.endswith("/shapes") and "cursor" not in place.query:
            name = "list.json"
            head += f'<link rel="preload" as="fetch" crossorigin href="{name}">'
        elif place.path.endswith("/thumbnail"):
            name = f"{number}.webp"
            pictures += f'<img src="{name}" width="256" height="256">'
        else:
            continue
        (folder / name).write_bytes(httpx.get(address, timeout=60).raise_for_status().content)
    begin = f'<!doctype html><meta charset="utf-8"><title>peer</title><link rel="icon" href="data:,">{head}<p>Library'
    (folder / "bytes.html").write_text(begin)
    (folder / "pictures.html").write_text(begin + pictures)


@contextmanager
def bare_server(folder: Path) -> Iterator[str]:
    """Serve a folder from another process."""
    command = [sys.executable, "-m", "benchmarks.web.bare", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        process.terminate()


def median(turns: list[dict[str, float]], mark: str) -> float:
    return statistics.median(turn[mark] for turn in turns)


# Frames.


def model_rows(browser: Browser, server: Server) -> list[list[str]]:
    surface = torus(columns=COLUMNS, rows=COLUMNS)
    with server.http() as http:
        shape = stored(http, ply(surface), file_name="torus.ply", parameters=f'{{"samples": {SAMPLES}}}')
    address = f"{server.url}/#/shape/{shape['id']}"
    found = [model_row(browser, address, whole=whole) for whole in (False, False, True)]
    names = ["as the page shows it, first time", "the same again", "every face"]
    return [[name, *row] for name, row in zip(names, found, strict=True)]


def model_row(browser: Browser, address: str, *, whole: bool) -> list[str]:
    """Open the torus; return the time until it is drawn, the sizes of frames at rest and turning, and their rate."""
    with fresh_page(browser) as page:
        if whole:
            page.route(re.compile(r"/view$"), lambda route: route.continue_(url=f"{route.request.url}?faces=1000000"))
        page.add_init_script(SHOWN)
        page.goto(address)
        page.wait_for_function("() => globalThis.shown")
        shown = page.evaluate("globalThis.shown")
        found = page.evaluate(SPIN, 1000 * SECONDS)
    sizes = [f"{found[when]['faces']:,.0f}; {found[when]['pixels'] / 1e6:.2f}" for when in ("still", "turning")]
    return [f"{shown / 1000:.1f} s", *sizes, f"{found['rate']:.1f}"]


def grid_row(browser: Browser, url: str, shapes: int, name: str, speed: int) -> list[str]:
    """Scroll through the real list of a new server, or a mocked one of 20,000; return how long the frames took."""
    with fresh_page(browser) as page:
        if shapes == GRID_SHAPES:
            mock_list(page, url)
        page.goto(url)
        page.get_by_text(f"{shapes:,} shapes", exact=True).wait_for()
        page.wait_for_timeout(500)
        found = page.evaluate(SCROLL, [1000 * SECONDS, speed])
    frames = np.array(found["frames"])
    rate = f"{1000 * len(frames) / frames.sum():.0f}"
    long = f"{np.count_nonzero(frames > LONG_FRAME)} of {len(frames)}"
    return [f"{shapes:,}", name, f"{speed:,}", rate, long, f"{frames.max():.0f} ms", str(found["cards"])]


def mock_list(page: Page, url: str) -> None:
    """Answer for the server: a list of 20,000 shapes, and, within the page, the same picture for each."""
    with httpx.Client(base_url=url, timeout=60) as http:
        shape: dict[str, Any] = http.get("/v1/shapes").json()["items"][0]
        picture = http.get(f"/v1/shapes/{shape['id']}/thumbnail").content

    def send(route: Route) -> None:
        query = httpx.URL(route.request.url).params
        first, limit = int(query.get("cursor", 0)), int(query["limit"])
        last = min(GRID_SHAPES, first + limit)
        items = [shape | {"id": f"{number:032x}", "name": f"shape {number}"} for number in range(first, last)]
        route.fulfill(json={"items": items, "next_cursor": str(last) if last < GRID_SHAPES else None})

    page.route(re.compile(r"/v1/shapes\?"), send)
    page.add_init_script(f"globalThis.picture = '{base64.b64encode(picture).decode()}';{ONE_PICTURE}")


# The section.


def packed_sizes() -> dict[str, int]:
    """Return the size of each script as the server sends it."""
    return {file.name: len(gzip.compress(file.read_bytes())) for file in (FOLDER / "assets").glob("*.js")}


def text(version: str, start: str, models: list[list[str]], grid: list[list[str]]) -> str:
    sizes = packed_sizes()
    viewer = sum(size for name, size in sizes.items() if name.startswith("viewer-"))
    others = sum(sizes.values()) - viewer
    model_header = ["torus of 500,000 faces", "until shown", "at rest: faces; megapixels", "turning", "frames a second"]
    grid_header = [
        "shapes",
        "scrolled",
        "pixels a second",
        "frames a second",
        "frames above 50 ms",
        "longest",
        "cards in the document",
    ]
    return f"""Chromium {version} without a window, 1280 x 860 pixels, and the server, on the same {available_cores()} cores at a load of {os.getloadavg()[0]:.0f}. WebGL ran in software (SwiftShader), which computes every pixel on these cores; a browser on a machine with a graphics card does not.

**Start**: a library of {SHAPES} shapes (SHREC'11, 500 faces), a new browser context each time. Milliseconds from the beginning of the navigation, medians of {TURNS}, in turns; at a new server, which has no pictures yet, of {COLD_TURNS}. Beside them: a static page that loads the same bytes from memory and runs no script (row 2: the scripts, styles and first list; row 3: also the pictures), and the ratio of the running server's time to its time. The target of the first cards is 1000 ms.

{start}

**Scripts**, as sent (gzip): the part with three.js, which the views in 3-D load when they are first opened, {viewer / 1000:.0f} kB (at most 300 kB is the target); all others together {others / 1000:.0f} kB, of {len(sizes) - 1} files.

**A large model** beside its signature: both panes are drawn in each of the frames of {SECONDS} seconds, while the camera turns. Until shown: from the beginning of the navigation to the first frame, after which the numbers beside it may still load. The page asks for at most 60,000 faces; the last row asks for all of them. Where whole frames are slow, as here, the page draws fewer faces and pixels while the camera turns, and a whole frame when it rests.

{table(model_header, models)}

**A long list**: {GRID_SHAPES:,} shapes, whose list and one picture come from the measuring program; and {SHAPES} shapes of a new server, which makes its pictures meanwhile. The browser offers at most 60 frames a second.

{table(grid_header, grid)}"""  # noqa: E501


if __name__ == "__main__":
    main()
