"""The documentation agrees with the code."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import tomllib
from dataclasses import asdict, fields
from pathlib import Path

import click
import pytest

import unbend
from unbend.api import Settings
from unbend.api.server.configuration import read_settings
from unbend.cli.main import main
from unbend.matching.measures import MEASURES
from unbend.mesh.policy import MeshPolicy
from unbend.signature.parameters import Parameters

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]


def test_every_setting_is_documented_with_its_default():
    text = (DOCS / "operations.md").read_text()
    rows = dict(re.findall(r"^\| `(UNBEND_\w+)` \| ([^|]+) \|", text, re.MULTILINE))
    assert set(rows) == {f"UNBEND_{name.upper()}" for name in Settings.model_fields}
    for name, field in Settings.model_fields.items():
        if field.default_factory is None:
            reported = rows[f"UNBEND_{name.upper()}"].strip().strip("`")
            assert reported == (f"{field.default:g}" if isinstance(field.default, float) else str(field.default))


def test_the_documented_settings_file_is_valid(tmp_path, monkeypatch):
    text = (DOCS / "operations.md").read_text()
    (example,) = re.findall(r"^```toml\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    for name in [name for name in os.environ if name.startswith("UNBEND_")]:
        monkeypatch.delenv(name)
    written = tomllib.loads(example)
    path = tmp_path / "settings.toml"
    path.write_text(example.replace(written["library"], str(tmp_path / "library.db")))
    found = read_settings({}, path)
    assert written | {"library": found.library} == found.model_dump(include=set(written))
    assert found.origins == ["https://example.org", "https://example.com:8443"]


@pytest.mark.parametrize(("heading", "defaults"), [("Parameters", Parameters()), ("Policy", MeshPolicy())])
def test_every_parameter_and_policy_field_is_documented_with_its_default(heading, defaults):
    section = (DOCS / "http.md").read_text().split(f"\n## {heading}\n")[1].split("\n## ")[0]
    rows = dict(re.findall(r"^\| `(\w+)` \| `?([^|`]+)`? \|", section, re.MULTILINE))
    assert rows == {name: json.dumps(value).strip('"') for name, value in asdict(defaults).items()}


def test_every_measure_is_documented():
    text = (DOCS / "how-it-works.md").read_text()
    assert all(f"| `{name}`" in text for name in MEASURES)


def test_every_dependency_is_explained_in_the_decisions():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    text = (DOCS / "decisions.md").read_text()
    extras = project["optional-dependencies"]
    optional = [requirement for extra in extras.keys() - {"test", "bench"} for requirement in extras[extra]]
    for requirement in (*project["dependencies"], *optional):
        name = re.split(r"[<>=\[]", requirement)[0]
        assert re.search(rf"\b{re.escape(name)}\b", text), requirement


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_relative_link_of_a_page_has_a_target(page):
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_every_name_in_the_steps_of_the_paper_exists():
    """In the table of docs/paper.md, Python names can be imported, flags are options, and fields are in OpenAPI."""
    section = (DOCS / "paper.md").read_text().split("\n## Every step and choice, by name\n")[1].split("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in section.splitlines()
        if re.match(r"\| \d", line)
    ]
    assert len(rows) > 30
    document = json.loads((DOCS.parent / "openapi" / "openapi.json").read_text())
    text = json.dumps(document)
    for _, _, python, command, http in rows:
        for name in re.findall(r"`([\w.]+)`", python):
            assert is_public(name), name
        for flag in re.findall(r"--[\w-]+", command):
            assert any(flag in parameter.opts for parameter in options()), flag
        for name in re.findall(r"`unbend ([a-z]+)", command):
            assert name in main.commands, name
        for field in re.findall(r"`(?:(GET|POST) )?([\w/{}]+)`", http):
            method, name = field
            if method:
                assert method.lower() in document["paths"][f"/v1{name}"], field
            else:
                assert f'"{name}"' in text, name


def test_every_section_that_a_script_prints_has_one_place_and_a_script():
    scripts = [path.read_text() for path in (ROOT / "benchmarks").rglob("*.py")]
    pages = [DOCS / "reliability.md", *sorted((DOCS / "benchmarks").glob("*.md"))]
    for page in pages:
        text = page.read_text()
        begun, ended = (re.findall(rf"^<!-- ([\w-]+): {word} -->$", text, re.MULTILINE) for word in ("begin", "end"))
        assert begun == ended, page.name
        assert len(set(begun)) == len(begun) > 0, page.name
        for name in begun:
            assert any(page.name in script and f'"{name}"' in script for script in scripts), (page.name, name)


def options() -> list[click.Parameter]:
    return [parameter for command in main.commands.values() for parameter in command.params]


def is_public(name: str) -> bool:
    """Tell whether a name is a measure, a member of a module, a name of `unbend`, or a field of such a class."""
    if name in MEASURES:
        return True
    if name.startswith("unbend."):
        module, _, last = name.rpartition(".")
        return hasattr(importlib.import_module(module), last)
    first, _, last = name.partition(".")
    found = getattr(unbend, first)
    return not last or last in dir(found) or last in {field.name for field in fields(found)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_path_on_a_page_exists(page):
    named = set(re.findall(r"`((?:\w+/)+[\w.]+\.\w+)`", page.read_text()))
    roots = (ROOT, ROOT / "service" / "unbend")
    assert {path for path in named if not any((root / path).exists() for root in roots)} == set()


def test_no_docstring_begins_with_that_of_what_or_who():
    for folder in (ROOT / "service" / "unbend", ROOT / "tests", ROOT / "benchmarks"):
        for path in folder.rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                    first = (ast.get_docstring(node) or "").partition(" ")[0]
                    assert first not in {"That", "Of", "What", "Who"}, f"{path}: {ast.get_docstring(node)}"
