"""The site builds without warnings, has no dead links, loads nothing from other hosts, and has a whole reference."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urlsplit

import click
import pytest

import unbend
from unbend.api import Settings
from unbend.cli.main import main
from unbend.errors import UnbendError, subclasses

pytest.importorskip("sphinx", reason="the extra `docs` is not installed")

from bs4 import BeautifulSoup
from sphinx.util.inventory import InventoryFile

ROOT = Path(__file__).parent.parent
LOADED = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src", "video": "src"}
"""The attribute by which an element loads a file."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "--builder", "html", "--fail-on-warning", "--keep-going", "--quiet"]
    command += ["--doctree-dir", str(tmp_path_factory.mktemp("doctrees")), str(ROOT / "docs"), str(folder)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, "")
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, BeautifulSoup]:
    """The pages of the site, without the templates of its theme."""
    paths = [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]
    return {path: BeautifulSoup(path.read_text(), "html.parser") for path in paths}


def test_every_markdown_page_is_in_the_navigation(pages, site):
    linked = {Path(link["href"]).name for link in pages[site / "index.html"].select("article a[href]")}
    for name in ("first-steps.html", "page.html", "method.html", "guides.html", "http.html", "reference.html"):
        assert name in linked
    built = {path.relative_to(site).with_suffix(".md") for path in pages}
    written = {path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md")}
    assert written <= built


def test_no_link_within_the_site_is_dead(pages, site):
    anchors = {path: {element["id"] for element in soup.select("[id]")} for path, soup in pages.items()}
    links = 0
    for path, soup in pages.items():
        for link in soup.select("a[href]"):
            address = urlsplit(link["href"])
            if address.scheme or address.netloc:
                continue
            links += 1
            target = (path.parent / unquote(address.path)).resolve() if address.path else path
            assert target.exists(), f"{path.relative_to(site)} links to {link['href']}"
            if address.fragment and target in anchors:
                assert unquote(address.fragment) in anchors[target], f"{path.relative_to(site)}: {link['href']}"
    assert links > 1000


def test_the_site_loads_nothing_from_elsewhere(pages, site):
    for path, soup in pages.items():
        for name, attribute in LOADED.items():
            for element in soup.select(f"{name}[{attribute}]"):
                address = urlsplit(element[attribute])
                assert not address.netloc, f"{path.relative_to(site)} loads {element[attribute]}"
                if address.scheme != "data":
                    assert (path.parent / unquote(address.path)).exists(), element[attribute]
    for sheet in site.rglob("*.css"):
        assert not re.search(r"""(url\(|@import)\s*["']?(https?:)?//""", sheet.read_text()), sheet


def test_the_equations_of_the_paper_are_shown_without_a_script(pages, site):
    soup = pages[site / "method.html"]
    numbers = [span.get_text() for span in soup.select(".equation > span")]
    assert numbers == ["(1)", "(2)", "(4)", "(5)", "(6)", "(7)", "(8)", "(9)", "(10)"]
    assert len(soup.select(".equation > math")) >= len(numbers)
    assert not [script for script in soup.select("script[src]") if "math" in script["src"].lower()]


def test_the_reference_has_every_public_name(site):
    with (site / "objects.inv").open("rb") as file:
        inventory = InventoryFile.load(file, "", lambda base, path: base + path)
    documented = {name for kind in ("py:class", "py:function") for name in inventory.get(kind, ())}
    assert {f"unbend.{name}" for name in unbend.__all__} <= documented


def test_the_reference_has_every_command_and_option(pages, site):
    soup = pages[site / "reference" / "commands.html"]
    sections = {section.h2.code.get_text(): section.get_text() for section in soup.select("section section")}
    assert {"unbend keys create", "unbend keys revoke"} <= set(sections)
    for name, command in main.commands.items():
        for parameter in command.params:
            if isinstance(parameter, click.Option):
                assert all(option in sections[f"unbend {name}"] for option in parameter.opts), (name, parameter.opts)
    assert "UNSET" not in soup.get_text()


def test_the_reference_has_every_error_and_setting(pages, site):
    errors = {cell.get_text() for cell in pages[site / "reference" / "errors.html"].select("td:first-child")}
    assert errors == {kind.code for kind in subclasses(UnbendError)}
    settings = {cell.get_text() for cell in pages[site / "reference" / "settings.html"].select("td:first-child")}
    assert settings == {f"UNBEND_{name.upper()}" for name in Settings.model_fields}


def test_the_reference_has_every_request(pages, site):
    headings = pages[site / "reference" / "requests.html"].select("h2 code")
    requests = {heading.get_text() for heading in headings}
    assert {"POST /v1/shapes", "DELETE /v1/shapes/{shape_id}", "POST /v1/queries"} <= requests
    assert (site / "openapi.json").exists()
