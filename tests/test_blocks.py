"""The code blocks of the README and of docs/ run: Python, shell and JavaScript, against a real server.

The blocks of a page run in their order in one folder, which has the files that they name. A block that cannot run says
so in a comment above it: `<!-- not run: reason -->`. An address of a server on a page stands for the server of these
tests, and a placeholder such as JOB_ID for an id of that server.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.blocks import SHELL, Block, blocks
from tests.support.server import SAMPLES, Server, ended, post_mesh, small_mesh, two_rings, without_settings
from unbend import Library, Surface
from unbend.mesh.shapes import figure, sheet
from unbend.mesh.write import write_mesh

ROOT = Path(__file__).parent.parent
ELSEWHERE = {"command-line.md"}
"""Pages whose examples another test runs: tests/cli/test_guide.py."""
PAGES = [ROOT / "README.md", *(page for page in sorted((ROOT / "docs").rglob("*.md")) if page.name not in ELSEWHERE)]
RUN = {"python", SHELL, "js"}
TEXTS = {"", "text", "json", "toml", "yaml"}
SECONDS = 600
"""Longest time of a block: its first run may compile kernels on a busy machine."""
SMALL = 1500
"""The vertices of a mesh; a figure needs as many."""

MEANT = {
    "FOLDER": "animals",
    "/backups/": "backups/",
    "revoke 5f2b7c1e9a0d": """revoke "$(unbend keys list | tail -n 1 | cut -d ' ' -f 1)\"""",
}
"""Words of the pages, and what they stand for in the folder of the blocks."""

KINDS = {"cat": "quadruped", "horse": "spider", "man": "biped"}

WRAPPERS = {
    "unbend": f'exec "{sys.executable}" -m unbend "$@"',
    # A page leaves out what a reader needs only for debugging; a test fails at the first refused request.
    "curl": f'exec "{shutil.which("curl")}" --fail-with-body --silent --show-error --max-time 60 "$@"',
}


@dataclass(frozen=True)
class Place:
    """Where the blocks run: a folder of meshes and libraries, the commands of the pages, and a server."""

    files: Path
    commands: Path
    server: Server

    def upload(self, number: int) -> dict[str, Any]:
        """Store a shape of a page, which its blocks may remove, and return the job."""
        with self.server.http() as http:
            return ended(http, post_mesh(http, small_mesh(number), parameters=json.dumps(SAMPLES)))

    def fill(self, text: str, job: dict[str, Any]) -> str:
        """Return a block with this server's address, ids and folders in the place of those of the page."""
        text = re.sub(r"http://127\.0\.0\.1:800\d", self.server.url, text)
        text = re.sub(r"(?<=/jobs/)(?:\{id\}|JOB_ID)", job["id"], text)
        text = re.sub(r"(?<=/shapes/)\{id\}|SHAPE_ID", job["shape_id"], text)
        if "OTHER_ID" in text:
            with self.server.http() as http:
                text = text.replace("OTHER_ID", http.get("/v1/shapes").json()["items"][0]["id"])
        for written, meant in MEANT.items():
            text = text.replace(written, meant)
        return text


def pose(kind: str, number: int) -> Surface:
    return figure(KINDS[kind], number, resolution=SMALL)


def piece_of(surface: Surface) -> Surface:
    """Return the part of a surface on one side of a plane."""
    middles = surface.vertices[surface.faces].mean(axis=1)[:, 0]
    return Surface(surface.vertices, surface.faces[middles < np.quantile(middles, 0.6)])


def noisy(surface: Surface) -> Surface:
    noise = np.random.default_rng(0).normal(scale=0.003 * surface.extent, size=surface.vertices.shape)
    return Surface(surface.vertices + noise, surface.faces)


def write(path: Path, surface: Surface) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(write_mesh(surface.vertices, surface.faces, path.suffix[1:]))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    """A server, and the files that the pages name: small figures in several poses, and libraries of them."""
    files, commands = tmp_path_factory.mktemp("files"), tmp_path_factory.mktemp("commands")
    for number, name in enumerate(("cat.off", "unknown.ply", "lion.off", "cat0.off", "cat7.off", "specimen.off")):
        write(files / name, pose("cat", number))
    write(files / "whole.ply", pose("man", 0))
    write(files / "piece.ply", piece_of(pose("man", 0)))
    write(files / "pieces" / "half.ply", piece_of(pose("man", 0)))
    write(files / "others" / "cat.off", pose("cat", 1))
    write(files / "shirt.obj", sheet())
    write(files / "scan.ply", noisy(pose("cat", 0)))
    write(files / "large.ply", figure(KINDS["cat"], 0, resolution=2 * SMALL))
    write(files / "assembly.obj", two_rings(0))
    (files / "landmarks.csv").write_text("17\n1204\n")
    (files / "backups").mkdir()
    labels = ["path,class"]
    with Library(str(files / "mine.db")) as library:
        for label in KINDS:
            for number in range(2):
                path = files / "animals" / label / f"{label}{number}.obj"
                write(path, pose(label, number))
                labels.append(f"{label}/{path.name},{label}")
                library.add(path, label=label)
    (files / "labels.csv").write_text("\n".join(labels) + "\n")
    shutil.copy(files / "mine.db", files / "unbend.db")
    for name, text in WRAPPERS.items():
        for path in (commands / name, files / ".venv" / "bin" / name):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"#!/bin/sh\n{text}\n")
            path.chmod(path.stat().st_mode | stat.S_IXUSR)
    served = tmp_path_factory.mktemp("served")
    shutil.copy(files / "mine.db", served / "library.db")
    with Server(served, parts=True) as server:
        yield Place(files, commands, server)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_blocks_of_a_page_run(page, request, tmp_path, monkeypatch):
    runnable = [block for block in blocks(page) if block.language in RUN and not block.reason]
    if not runnable:
        return
    for tool, needed in {"node": "js", "curl": SHELL}.items():
        if shutil.which(tool) is None and any(block.language == needed for block in runnable):
            pytest.skip(f"{tool} is not installed")
    place = request.getfixturevalue("place")
    shutil.copytree(place.files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    job = place.upload(PAGES.index(page))
    names: dict[str, object] = {"__name__": "__main__"}  # a reader runs the blocks of a page in one session
    for block in runnable:
        run(block, place.fill(block.text, job), place.commands, names)


def run(block: Block, text: str, commands: Path, names: dict[str, object]) -> None:
    if block.language == "python":
        try:
            exec(compile("\n" * (block.line - 1) + text, str(block.page), "exec"), names)  # noqa: S102
        except Exception as error:
            error.add_note(f"in the block at {block.page}:{block.line}")
            raise
        return
    command = ["bash", "-euo", "pipefail", "-c", text]
    if block.language == "js":
        command = ["node", "--input-type=module", "--eval", text]
    environment = without_settings(PATH=f"{commands}{os.pathsep}{os.environ['PATH']}")
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False)
    assert result.returncode == 0, f"{block.page}:{block.line}\n{text}\n{result.stdout}\n{result.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_has_a_known_language(page):
    """A block of an unknown language would not run, and nobody would notice."""
    found = {block.language for block in blocks(page) if not block.language.startswith("{")}
    assert found <= RUN | TEXTS
