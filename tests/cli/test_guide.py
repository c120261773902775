"""The examples of docs/command-line.md work, in their order."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

from tests.support.commands import in_process, succeeded
from tests.support.server import Server, endless_mesh
from unbend import Client
from unbend.cli.main import main
from unbend.mesh.shapes import ellipsoid, sheet, torus
from unbend.mesh.write import write_mesh

GUIDE = Path(__file__).parents[2] / "docs/command-line.md"
ID = re.compile(r"\b[0-9a-f]{32}\b")
SHAPES = {
    "bird-00": ellipsoid((1.0, 0.7, 0.4), subdivisions=2), "bird-01": ellipsoid((1.0, 0.7, 0.5), subdivisions=2),
    "bird-02": ellipsoid((1.0, 0.6, 0.4), subdivisions=2), "sheet-00": sheet(columns=8, rows=6),
    "sheet-01": sheet(columns=9, rows=6), "ring-00": torus(columns=10, rows=6),
}  # fmt: skip
"""Small meshes in place of those of `unbend demo`."""


def examples() -> list[str]:
    return re.findall(r"^    (unbend .*)$", GUIDE.read_text(), re.MULTILINE)


def test_every_command_has_a_row_and_an_example():
    rows = set(re.findall(r"`([\w-]+)`", " ".join(re.findall(r"^\|([^|]*)\|", GUIDE.read_text(), re.MULTILINE))))
    used = {example.split()[1] for example in examples()}
    assert set(main.commands) - {"serve", "worker", "jobs", "openapi"} <= rows
    assert set(main.commands) == used


def test_the_examples_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "animals").mkdir()
    (tmp_path / "landmarks.csv").write_text("3\n7\n")
    for name, surface in SHAPES.items():
        (tmp_path / f"animals/{name}.ply").write_bytes(write_mesh(surface.vertices, surface.faces, "ply"))
    lines = ["path,class", *(f"{name}.ply,{name.split('-')[0]}" for name in SHAPES)]
    (tmp_path / "animals/labels.csv").write_text("\n".join(lines))
    with Server(tmp_path, workers=1) as server, Client(server.url) as client:
        for example in examples():
            words = shlex.split(example)[1:]
            if words[0] in {"demo", "serve", "worker", "sweep", "index"}:  # made or started above, or by other tests
                continue
            given = [word.replace("http://127.0.0.1:8000", server.url) for word in words]
            if "--cancel" in given:
                given[-1] = client.submit(endless_mesh()).id
            elif any(map(ID.fullmatch, given)):
                birds = in_process("list", "--label", "bird", "--json").stdout
                eagles = in_process("list", "--label", "eagle", "--json").stdout
                found = json.loads(eagles)["shapes"] or json.loads(birds)["shapes"]
                given = [ID.sub(found[0]["id"], word) for word in given]
            succeeded(*given, run=in_process)
    for name in ("bird.png", "report.html", "exported/labels.csv", "monday.db", "signature.ply", "carried/bird-02.csv"):
        assert (tmp_path / name).exists(), name
