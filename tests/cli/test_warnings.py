"""Warnings about meshes on standard error of every command, and file names that are not UTF-8."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import in_process, succeeded
from tests.support.server import DAMAGED, ply, small_mesh
from unbend import Library, Surface
from unbend.mesh.shapes import sphere, torus

FEW = ["--samples", 8]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder of four rings in two classes, and a file with two disconnected spheres."""
    made = tmp_path_factory.mktemp("parts")
    ball = sphere(1)
    vertices = np.concatenate([ball.vertices, ball.vertices + 3])
    apart = Surface(vertices, np.concatenate([ball.faces, ball.faces + len(ball.vertices)]))
    (made / "apart.ply").write_bytes(ply(apart))
    rows = ["path,class", "apart.ply,a"]
    for number in range(4):
        (made / f"ring{number}.ply").write_bytes(ply(torus(minor=0.2 + 0.05 * number, columns=10, rows=6)))
        rows.append(f"ring{number}.ply,{'ab'[number // 2]}")
    (made / "labels.csv").write_text("\n".join(rows) + "\n")
    return made


def warnings_in(text: str) -> list[str]:
    return [line for line in text.splitlines() if ": warning: " in line]


@pytest.mark.parametrize("place", ["library", "url"])
def test_import_and_query_warn_about_a_dropped_component(folder, tmp_path, server, place):
    where = ["--library", tmp_path / "a.db"] if place == "library" else ["--url", server.url]
    (line,) = warnings_in(succeeded("import", folder, *where, *FEW, run=in_process).stderr)
    assert line.startswith(f"{folder / 'apart.ply'}: warning: only 50.0% of the area was kept")
    asked = succeeded("query", folder / "apart.ply", *where, *FEW, "--json", run=in_process)
    (line,) = warnings_in(asked.stderr)
    assert line.startswith("apart.ply: warning: only 50.0%")
    assert json.loads(asked.stdout)["warnings"] == [line.removeprefix("apart.ply: warning: ")]


@pytest.mark.parametrize(
    "command",
    [
        ["signature", "apart.ply"],
        ["flatten", "apart.ply", "-o", "flat.obj"],
        ["compare", "ring0.ply", "apart.ply"],
        ["evaluate", ".", "--labels", "labels.csv", "--measure", "spectrum"],
    ],
    ids=lambda command: command[0],
)
def test_every_command_that_reads_a_mesh_warns_about_a_dropped_component(folder, command, monkeypatch):
    monkeypatch.chdir(folder)
    (line,) = warnings_in(succeeded(*command, *FEW, run=in_process).stderr)
    assert "apart.ply: warning: only 50.0%" in line
    linked = succeeded(*command, *FEW, "--components", "bridge", run=in_process)
    assert warnings_in(linked.stderr) == []


def test_files_whose_names_are_not_utf8_are_imported_and_reported(tmp_path):
    names = [b"a.ply", b"m\xe9.ply", b"caf\xe9/m\xe9.ply", b"caf\xe9/bad\xe9.off", b"z.ply"]
    for number, name in enumerate(names):
        file = tmp_path / "in" / os.fsdecode(name)
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(DAMAGED if b"bad" in name else small_mesh(number))
    path = tmp_path / "a.db"
    done = in_process("import", tmp_path / "in", "--library", path, "--label-from", "folder", *FEW)
    assert (done.returncode, done.stdout) == (4, "4 of 5 shapes imported: 4 new\n")
    line, *counts = done.stderr.splitlines()
    assert line.startswith(rf"{tmp_path}/in/caf\xe9/bad\xe9.off: ")
    assert [count.split() for count in counts] == [["5", "files", "found"], ["4", "new"], ["1", "failed"]]
    with Library(str(path)) as library:
        shapes = library.page().items
    assert sorted((shape.name, shape.label) for shape in shapes) == [
        ("a", "in"), (r"m\xe9", r"caf\xe9"), (r"m\xe9", "in"), ("z", "in"),
    ]  # fmt: skip
    out = os.fsdecode(os.fsencode(tmp_path) + b"/out\xe9")
    assert succeeded("export", out, "--library", path).stdout == rf"{tmp_path}/out\xe9: 4 shapes" + "\n"
    reported = succeeded("evaluate", out, "--labels", f"{out}/labels.csv", *FEW, "--json")
    assert set(json.loads(reported.stdout)) >= {"spectrum"}


def test_a_file_of_labels_may_name_files_that_are_not_utf8(tmp_path):
    for number, name in enumerate([b"m\xe9.ply", b"n\xe9.ply"]):
        (tmp_path / os.fsdecode(name)).write_bytes(small_mesh(number))
    labels, path = tmp_path / "labels.csv", tmp_path / "a.db"
    labels.write_bytes(b"path,class\nm\xe9.ply,ring\nn\xe9.ply,ring\n")
    done = succeeded("import", tmp_path, "--labels", labels, "--library", path, *FEW)
    assert done.stdout == "2 of 2 shapes imported: 2 new\n"
    with Library(str(path)) as library:
        assert library.labels() == {"ring": 2}
    page = tmp_path / "page.html"
    reported = succeeded("evaluate", tmp_path, "--labels", labels, *FEW, "--per-class", "--html", page)
    assert "ring" in reported.stdout
    assert r"m\xe9.ply" in page.read_text(encoding="utf-8")
    labels.write_bytes(b"path,class\nm\xe9.ply,caf\xe9\n")
    assert r"line 2: the class caf\xe9 is not UTF-8" in in_process("import", tmp_path, "--labels", labels).stderr
    labels.write_bytes("path,class\n".encode("utf-16"))
    assert "must be CSV in UTF-8" in in_process("import", tmp_path, "--labels", labels).stderr
