"""Pictures of each view of the web page, from a running server with the 53 real shapes of TOSCA.

    python -m benchmarks.web.screens [FOLDER]

Keeps the library in FOLDER, so that a second run need not compute it again; by default in a temporary folder. Writes
docs/pictures/page-*.webp: wide ones in light colours, narrow ones in dark colours.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import httpx
import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page

from benchmarks.common import DATA, ROOT
from benchmarks.retrieval.data import listed
from benchmarks.web.browser import chromium, fresh_page
from tests.support.server import Server, ply, stored
from unbend import geodesic_distances, read_mesh
from unbend.library import Library
from unbend.mesh.shapes import s_bend

PICTURES = ROOT / "docs" / "pictures"
ASKED = DATA / "tosca5k" / "cat0.off"
"""The mesh that the library does not contain, and that is asked for."""
SHAPE, OTHER = "cat3", "cat7"
LASSO = "horse"
"""The class that is selected on the map."""
MARGIN = 16
WIDE, NARROW = 1280, 390

DRAWN = """() => [...document.querySelectorAll(".thumbnail img")].every((image) => {
  const { top, bottom, left, right } = image.getBoundingClientRect();
  const visible = bottom > 0 && top < innerHeight && right > 0 && left < innerWidth;
  return !visible || (image.complete && image.naturalWidth > 0);
})"""


@dataclass(frozen=True)
class Shot:
    """A view, its address, what to do there, and the heights of its wide and narrow picture."""

    name: str
    address: str
    ready: str
    """A selector of the last thing that the view shows."""
    act: Callable[[Page], None] = lambda page: None  # noqa: ARG005
    heights: tuple[int, int] = (860, 844)


def main() -> None:
    if len(sys.argv) > 1:
        draw_all(Path(sys.argv[1]))
    else:
        with TemporaryDirectory(prefix="unbend-screens-") as folder:
            draw_all(Path(folder))


def draw_all(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    fill(folder / "library.db")
    with Server(folder, call_seconds=600) as server, chromium() as browser:
        for shot in shots(server):
            draw(browser, server, shot)
        # The sheet comes last, because it would be far from all others on the map.
        surface = s_bend(columns=80, rows=40)
        with server.http() as http:
            shape = stored(http, ply(surface), file_name="curtain.ply", label="sheet")
            draw(browser, server, Shot("flatten", f"flatten/{shape['id']}", ".stage canvas"))
            http.delete(f"/v1/shapes/{shape['id']}").raise_for_status()


def fill(path: Path) -> None:
    """Store the shapes of TOSCA, all but one."""
    paths, labels = listed("tosca5k", merged=False)
    with Library(str(path)) as library:
        for file, label in zip(paths, labels, strict=True):
            if file != ASKED:
                library.add(file, label=label)


def shots(server: Server) -> list[Shot]:
    with server.http() as http:
        ids = {shape["name"]: shape["id"] for shape in http.get("/v1/shapes", params={"limit": 500}).json()["items"]}
    first, second = far_points(DATA / "tosca5k" / f"{SHAPE}.off")
    return [
        Shot("library", "library?order=label", "li.card img[src]"),
        Shot("shape", f"shape/{ids[SHAPE]}?from={first}&to={second}", ".lengths b >> nth=1", heights=(1170, 1180)),
        Shot("pair", f"pair/{ids[SHAPE]}/{ids[OTHER]}", ".pair canvas"),
        Shot("ask", "ask", ".drop", ask, heights=(1000, 1100)),
        Shot("map", "map", ".classes-legend li", lambda page: lasso(page, server)),
        Shot("evaluation", "evaluation", ".metrics tbody tr >> nth=5", mistakes, heights=(1480, 1400)),
    ]


def far_points(file: Path) -> tuple[int, int]:
    """Return two vertices far apart along a surface."""
    surface = read_mesh(file)
    first = int(geodesic_distances(surface, [0])[0].argmax())
    return first, int(geodesic_distances(surface, [first])[0].argmax())


def ask(page: Page) -> None:
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Choose a mesh").click()
    chooser.value.set_files(str(ASKED))
    page.locator(".ranked li").first.wait_for()


def lasso(page: Page, server: Server) -> None:
    """Draw a lasso around the points of a class, in the first plot."""
    items = httpx.get(f"{server.url}/v1/map", params={"measure": "spectrum"}, timeout=300).json()["items"]
    points = np.array([item["point"][:2] for item in items])
    points -= points.mean(axis=0)
    box = page.locator(".canvas canvas").first.bounding_box()
    assert box is not None
    scale = 0.46 * min(box["width"], box["height"]) / np.linalg.norm(points, axis=1).max()
    places = np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]) + scale * points * [1, -1]
    chosen = places[[item["label"] == LASSO for item in items]]
    (left, top), (right, bottom) = chosen.min(axis=0) - MARGIN, chosen.max(axis=0) + MARGIN
    page.keyboard.down("Shift")
    page.mouse.move(left, top)
    page.mouse.down()
    for x, y in [(right, top), (right, bottom), (left, bottom)]:
        page.mouse.move(x, y, steps=8)
    page.mouse.up()
    page.keyboard.up("Shift")
    page.mouse.move(0, 0)


def mistakes(page: Page) -> None:
    """Press the largest number of confusions."""
    page.wait_for_function("() => !document.querySelector('.metrics td.hint')")
    cells = page.locator(".wrong .cell")
    counts = [int(count) for count in cells.all_inner_texts()]
    cells.nth(int(np.argmax(counts))).click()
    page.locator(".mistakes .loading").wait_for(state="detached")
    page.evaluate("() => (document.activeElement.blur(), scrollTo(0, 0))")


def draw(browser: Browser, server: Server, shot: Shot) -> None:
    """Write the wide and the narrow picture of a view."""
    for width, height, dark in [(WIDE, shot.heights[0], False), (NARROW, shot.heights[1], True)]:
        with fresh_page(browser, width=width, height=height, dark=dark) as page:
            page.goto(f"{server.url}/#/{shot.address}")
            page.locator(shot.ready).first.wait_for()
            page.wait_for_timeout(1000)  # the first frames
            shot.act(page)
            page.wait_for_function(DRAWN)
            page.wait_for_timeout(1000)
            write(page.screenshot(), f"page-{shot.name}{'-narrow' if width == NARROW else ''}.webp")


def write(data: bytes, name: str) -> None:
    """Write a picture as WebP, which is smaller than PNG, and keeps the shades that 256 colours would lose."""
    Image.open(io.BytesIO(data)).convert("RGB").save(PICTURES / name, quality=88, method=6)
    print(f"{name} {(PICTURES / name).stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
