"""The command line: its output, its messages and its exit status."""

from __future__ import annotations

import base64
import io
import json
import re
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support.commands import failed_with_a_sentence, in_process, on_terminal, succeeded, unbend
from tests.support.server import DAMAGED, SAMPLES, Server, endless_mesh, ply, two_rings
from unbend import Client, Library, MeshPolicy, Parameters, Surface, compare, compute_signature, read_mesh
from unbend.matching.evaluate import evaluate
from unbend.matching.measures import VECTOR_MEASURES, get_vector_measure
from unbend.mesh.shapes import cylinder, sheet, torus
from unbend.render.picture import render_picture
from unbend.render.request import PictureRequest

COMMANDS = {
    "serve", "signature", "flatten", "show", "compare", "import", "export", "query", "evaluate", "backup", "restore",
    "keys", "openapi", "demo", "complete", "match", "transfer", "symmetry", "list", "label", "remove", "jobs",
    "compute", "worker", "index", "migrate", "migrate-library", "sweep",
}  # fmt: skip
FIGURES = {"nn", "ft", "st", "e", "dcg", "map"}
GRID = {"columns": 12, "rows": 6}
MEMBERS = {
    "sheets/flat.ply": sheet(**GRID), "sheets/rolled.ply": cylinder(**GRID), "sheets/shut.ply": cylinder(5.0, **GRID),
    "rings/thin.ply": torus(minor=0.3, columns=12, rows=8), "rings/thick.ply": torus(minor=0.33, columns=12, rows=8),
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder of two classes in two subfolders, with a file of labels."""
    made = tmp_path_factory.mktemp("meshes")
    lines = ["path,class,more"]
    for name, surface in MEMBERS.items():
        path = made / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(ply(surface))
        lines.append(f"{name},{path.parent.name},ignored")
    (made / "labels.csv").write_text("\n".join(lines) + "\n")
    (made / "notes.txt").write_text("no mesh")
    return made


@pytest.fixture(scope="module")
def library(folder, tmp_path_factory) -> str:
    """A library with the shapes of the folder."""
    path = tmp_path_factory.mktemp("library") / "library.db"
    done = succeeded("import", folder, "--labels", folder / "labels.csv", "--library", path)
    assert done.stdout == "5 of 5 shapes imported: 5 new\n"
    return str(path)


def test_help_lists_the_commands():
    reported = succeeded("--help").stdout
    listed = reported.split("Commands:\n")[1].split("\n\n")[0]
    assert {line.split()[0] for line in listed.splitlines()} == COMMANDS
    assert succeeded("--version").stdout.strip() == "unbend, version 0.1.0"


def test_help_imports_no_heavy_packages():
    heavy = "('numpy', 'numba', 'scipy', 'trimesh', 'sqlalchemy', 'fastapi', 'httpx', 'rich', 'asyncio', 'logging')"
    code = f"import sys, unbend.cli; print([name for name in {heavy} if name in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_has_help(command):
    assert "Usage:" in succeeded(command, "--help", run=in_process).stdout


def test_the_whole_option_gives_every_vertex(folder, tmp_path):
    mesh, output = folder / "sheets/rolled.ply", tmp_path / "form.ply"
    done = succeeded("signature", mesh, "-o", output, "--whole", "--samples", 30, run=in_process)
    surface = read_mesh(mesh)
    assert f"{len(surface.vertices)} points in 3 dimensions" in done.stderr
    form = read_mesh(output)
    np.testing.assert_array_equal(form.faces, surface.faces)
    samples = compute_signature(surface, Parameters(samples=30))
    np.testing.assert_allclose(form.vertices[samples.samples], samples.points, atol=1e-6)


def test_a_rolled_sheet_is_flattened_without_distortion(folder, tmp_path):
    output = tmp_path / "flat.obj"
    done = succeeded("flatten", folder / "sheets/rolled.ply", "-o", output, "--samples", 60, run=in_process)
    assert "turned over" in done.stderr
    lines = output.read_text().splitlines()
    uv = np.array([line.split()[1:] for line in lines if line.startswith("vt ")], float)
    assert uv.min() >= 0
    np.testing.assert_allclose(np.sort(np.ptp(uv, axis=0)), [GRID["rows"] / GRID["columns"], 1.0], atol=0.02)
    refused = in_process("flatten", folder / "sheets/rolled.ply", "-o", tmp_path / "flat.off")
    assert refused.returncode != 0
    assert "obj, glb" in refused.stderr


def test_auto_dimensions_are_found(folder):
    done = succeeded("signature", folder / "sheets/rolled.ply", "--samples", 30, "--dimensions", "auto", run=in_process)
    reported = json.loads(done.stdout)
    assert reported["parameters"]["dimensions"] == "auto"
    assert len(reported["points"][0]) == 2


@pytest.mark.parametrize("file_type", ["ply", "obj", "off", "glb", "npz", "json"])
def test_a_signature_is_written_in_every_format(folder, tmp_path, file_type):
    mesh, output = folder / "sheets/rolled.ply", tmp_path / f"out.{file_type.upper()}"
    done = succeeded(
        "signature", mesh, "-o", output, "--samples", 30, "--dimensions", 2, "--method", "classical", run=in_process
    )
    assert done.stdout == ""
    assert "30 points in 2 dimensions" in done.stderr
    expected = compute_signature(read_mesh(mesh), Parameters(samples=30, dimensions=2, method="classical")).points
    if file_type == "json":
        points = np.array(json.loads(output.read_text())["points"])
    elif file_type == "npz":
        with np.load(output) as arrays:
            points = arrays["points"]
    else:
        points = read_mesh(output).vertices
        assert (points[:, 2] == 0).all()
    np.testing.assert_allclose(points[:, :2], expected, atol=1e-6)


def test_a_signature_is_printed_as_one_json_object(folder):
    command = ("signature", folder / "rings/thin.ply", "--samples", 20)
    succeeded(*command, run=in_process)  # compiles the kernels, of which a process would say so
    done = succeeded(*command)
    assert json.loads(done.stdout)["parameters"] == Parameters(samples=20).as_dict()
    assert done.stderr == ""


def test_every_parameter_is_an_option(folder):
    chosen = {
        "samples": "auto", "tolerance": 0.2, "dimensions": "auto", "criterion": "stress", "threshold": 0.01,
        "starts": 2, "seed": 7, "weights": "inverse", "first_sample": "random", "update": "planar", "scaling": "box",
        "method": "least_squares",
    }  # fmt: skip
    assert set(chosen) == set(asdict(Parameters()))
    options = [word for name, value in chosen.items() for word in (f"--{name.replace('_', '-')}", value)]
    done = succeeded("signature", folder / "rings/thin.ply", *options, run=in_process)
    reported, expected = (
        json.loads(done.stdout),
        compute_signature(read_mesh(folder / "rings/thin.ply"), Parameters(**chosen)),
    )
    assert reported["parameters"] == Parameters(**chosen).as_dict()
    np.testing.assert_allclose(reported["points"], expected.points, atol=1e-6)


def test_repairs_are_reported_on_standard_error(tmp_path):
    surface = sheet(columns=3, rows=2)
    corners = [" ".join(map(str, vertex)) for vertex in [*surface.vertices.tolist(), [9, 9, 9]]]
    faces = ["3 " + " ".join(map(str, face)) for face in surface.faces.tolist()]
    (tmp_path / "x.off").write_text("\n".join([f"OFF {len(corners)} {len(faces)} 0", *corners, *faces]))
    done = succeeded("signature", tmp_path / "x.off", run=in_process)
    assert done.stderr.startswith("x.off: ")
    json.loads(done.stdout)


@pytest.mark.parametrize("measure", [None, "moments"])
def test_compare_prints_the_distance(folder, measure):
    a, b = folder / "sheets/flat.ply", folder / "rings/thin.ply"
    options = ["--measure", measure] if measure else []
    reported = float(succeeded("compare", a, b, *options, run=in_process).stdout)
    expected = compare(*(compute_signature(read_mesh(path)) for path in (a, b)), measure or "spectrum")
    assert reported == pytest.approx(expected, rel=1e-5)
    assert float(succeeded("compare", a, a, *options, run=in_process).stdout) == 0


def test_an_import_with_labels_stores_every_file_with_its_class(library):
    with Library(library) as opened:
        assert opened.labels() == {"sheets": 3, "rings": 2}
        assert {shape.name for shape in opened.page().items} == {Path(name).stem for name in MEMBERS}


def test_an_import_can_use_folders_as_labels_and_names_files_that_fail(folder, tmp_path):
    for name in MEMBERS:
        (tmp_path / "in" / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / "in" / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "in/rings/broken.off").write_bytes(DAMAGED)
    (tmp_path / "in/rings/folder.off").mkdir()  # a folder with the name of a mesh
    done = unbend("import", tmp_path / "in", "--label-from", "folder", "--library", tmp_path / "library.db")
    assert done.returncode == 4, done.stderr
    assert done.stdout == "5 of 6 shapes imported: 5 new\n"
    assert sum(": " in line for line in done.stderr.splitlines()) == 1
    assert str(tmp_path / "in/rings/broken.off") in done.stderr
    assert "ends early" in done.stderr
    with Library(str(tmp_path / "library.db")) as opened:
        assert opened.labels() == {"sheets": 3, "rings": 2}


def test_a_repeated_import_stores_nothing_twice(folder, library):
    assert (
        succeeded("import", folder, "--library", library, run=in_process).stdout
        == "5 of 5 shapes imported: 0 new, 5 unchanged\n"
    )
    with Library(library) as opened:
        assert len(opened) == 5
        assert opened.labels() == {"sheets": 3, "rings": 2}


def test_the_library_can_be_set_by_the_environment(folder, library):
    reported = succeeded("query", folder / "sheets/flat.ply", "--json", UNBEND_LIBRARY=library, run=in_process).stdout
    assert len(json.loads(reported)["shapes"]) == 5


def test_an_import_over_http_stores_valid_files_and_names_the_others(folder, tmp_path, small_server):
    for name in MEMBERS:
        (tmp_path / "in" / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / "in" / name).write_bytes((folder / name).read_bytes())
    (tmp_path / "in/aaa.off").write_bytes(DAMAGED)
    (tmp_path / "in/bbb.ply").write_bytes(endless_mesh())  # too large for this server
    done = unbend("import", tmp_path / "in", "--label-from", "folder", "--url", small_server.url)
    assert done.returncode == 4, done.stderr
    assert done.stdout.startswith("5 of 7 shapes imported: ")
    assert sum(": " in line for line in done.stderr.splitlines()) == 2
    assert "aaa.off: " in done.stderr
    assert "bbb.ply: " in done.stderr
    with Client(small_server.url) as client:
        classes = client.labels()
        assert (classes["sheets"], classes["rings"]) == (3, 2)


def test_a_query_gives_the_same_result_from_a_library_and_a_service(folder, tmp_path, library, server):
    query = tmp_path / "query.ply"
    query.write_bytes(ply(cylinder(4.0, **GRID)))
    reported = json.loads(
        succeeded("query", query, "--library", library, "--json", "-k", 2, "--measure", "moments").stdout
    )
    with Library(library) as opened:
        assert reported == opened.rank(compute_signature(read_mesh(query)), measure="moments", k=2).as_dict()
    table = succeeded("query", query, "--library", library, "-k", 2, run=in_process).stdout
    assert table.splitlines()[1].split()[0] == "sheets"
    assert len(table.split("\n\n")[1].splitlines()) == 3
    with Library(str(server.library)) as opened, Client(server.url) as client:
        for path in (folder / name for name in MEMBERS):
            client.submit(path, label=path.parent.name).result(60)
        expected = opened.rank(compute_signature(read_mesh(query)), k=3).as_dict()
    assert json.loads(succeeded("query", query, "--url", server.url, "--json", "-k", 3).stdout) == expected


def test_a_piece_is_asked_about_and_an_old_library_is_completed(tmp_path, library):
    path = tmp_path / "piece.ply"
    whole = torus(minor=0.3, columns=12, rows=8)
    path.write_bytes(ply(Surface(whole.vertices, whole.faces[: len(whole.faces) // 2])))
    asked = ("query", path, "--library", library, "--measure", "partial")
    lines = succeeded(*asked, run=in_process).stdout.splitlines()
    assert lines[1].split()[0] == "rings"
    assert (
        next(line for line in lines if line.startswith("thin"))
        .rpartition(" middle at ")[0]
        .endswith("part of it, 50% of its area,")
    )
    assert json.loads(succeeded(*asked, "--json", run=in_process).stdout)["shapes"][0]["part"]["relation"] == "part"
    assert succeeded("complete", "--library", library, run=in_process).stdout == "nothing is missing\n"
    old = tmp_path / "old.db"
    dump = Path(__file__).parents[1] / "library/released/0009.sql"
    with closing(sqlite3.connect(old)) as connection:
        connection.executescript(dump.read_text(encoding="utf-8"))
    assert succeeded("complete", "--library", old, run=in_process).stdout.endswith("completed 2 shapes\n")


OPTIONS = ["--samples", 30, "--dimensions", 2, "--method", "classical", "--seams", "keep", "--components", "bridge",
           "--max-vertices", 70, "--smooth", 2]  # fmt: skip
CHOSEN = Parameters(samples=30, dimensions=2, method="classical")
READ = MeshPolicy(components="bridge", max_vertices=70, smooth=2, seams="keep")


@pytest.fixture(scope="module")
def rings(tmp_path_factory) -> Path:
    """A folder with one mesh of two components."""
    made = tmp_path_factory.mktemp("rings")
    (made / "rings.ply").write_bytes(ply(two_rings(7)))
    return made


@pytest.mark.parametrize("place", ["library", "url"])
def test_an_import_and_a_query_apply_their_options(rings, tmp_path, server, place):
    where = ["--library", tmp_path / "a.db"] if place == "library" else ["--url", server.url]
    succeeded("import", rings, *where, *OPTIONS, run=in_process)
    with Library(str(tmp_path / "a.db" if place == "library" else server.library)) as opened:
        record = opened.page(limit=500).items[-1]
    assert (record.name, record.parameters, record.policy) == ("rings", CHOSEN, READ)
    query = ["query", rings / "rings.ply", *where, "--json"]
    (match,) = json.loads(succeeded(*query, *OPTIONS, run=in_process).stdout)["shapes"]
    assert (match["id"], match["distance"]) == (record.id, 0.0)
    (match,) = json.loads(succeeded(*query, *OPTIONS[:-6], run=in_process).stdout)["shapes"]
    assert match["id"] == record.id
    assert match["distance"] > 0.0
    others = in_process(*query)  # with the default parameters, with which another test may have stored shapes
    assert record.id not in others.stdout
    assert others.stdout or "no shape compares" in others.stderr


def test_compare_applies_its_options(rings, folder):
    a, b = rings / "rings.ply", folder / "rings/thin.ply"
    reported = float(succeeded("compare", a, b, *OPTIONS, run=in_process).stdout)
    expected = compare(*(compute_signature(read_mesh(path, policy=READ), CHOSEN) for path in (a, b)))
    assert reported == pytest.approx(expected, rel=1e-5)
    assert reported != pytest.approx(float(succeeded("compare", a, b, *OPTIONS[:-6], run=in_process).stdout), rel=1e-3)


def test_a_signature_reports_that_its_mesh_was_simplified(rings):
    done = succeeded("signature", rings / "rings.ply", "--components", "bridge", "--max-vertices", 50, run=in_process)
    assert len(json.loads(done.stdout)["samples"]) <= 50
    assert "simplified from 78 to" in done.stderr
    assert "1 link between 2 components" in done.stderr


def test_an_evaluation_can_include_the_separation_of_classes(folder, tmp_path):
    labels, page = folder / "labels.csv", tmp_path / "report.html"
    asked = ["evaluate", folder, "--labels", labels, "--separation", "--samples", 40, "--measure", "moments"]
    reported = json.loads(succeeded(*asked, "--json", "--html", page).stdout)
    assert set(reported) == {"moments", "separation"}
    assert set(reported["separation"]) == {"moments", "dimensions"}
    assert set(reported["separation"]["moments"]) == {"nearest", "ratio"}
    over = reported["separation"]["dimensions"]
    assert over["pairs"] == [["sheets", "rings"]]
    assert {method: len(of) for method, of in over["medians"].items()} == {"least_squares": 6, "classical": 6}
    assert over["medians"]["least_squares"][2] > 0
    shown = page.read_text()
    assert 'id="separation"' in shown
    assert f"{over['medians']['least_squares'][2]:.3f}" in shown
    text = succeeded(*asked).stdout
    assert f"{over['medians']['classical'][5]:.3f}" in text
    assert "m = 6" in text


def test_an_evaluation_applies_its_reading_options(folder, rings):
    labels = rings / "labels.csv"
    labels.write_text(f"path,class\nrings.ply,b\n{folder}/rings/thin.ply,a\n{folder}/rings/thick.ply,a\n")
    reported = succeeded("evaluate", rings, "--labels", labels, "--components", "error", "--json", run=in_process)
    assert set(json.loads(reported.stdout)) == set(VECTOR_MEASURES)
    assert "rings.ply: the mesh has 2 components" in reported.stderr
    assert succeeded("evaluate", rings, "--labels", labels, "--components", "bridge", run=in_process).stderr == ""


def test_an_import_with_options_that_the_service_refuses_fails_with_one_line(folder, server):
    for option, word in (("--samples", "samples"), ("--max-vertices", "max_vertices")):
        failed_with_a_sentence(in_process("import", folder, "--url", server.url, option, 3), word)


def test_an_evaluation_prints_the_metrics_of_every_measure_as_json(folder):
    done = succeeded("evaluate", folder, "--labels", folder / "labels.csv", "--json", "--samples", 40)
    reported = json.loads(done.stdout)
    assert set(reported) == set(VECTOR_MEASURES)
    signatures = [compute_signature(read_mesh(folder / name), Parameters(**SAMPLES)) for name in MEMBERS]
    labels = [name.split("/")[0] for name in MEMBERS]
    for name, figures in reported.items():
        assert set(figures) == FIGURES
        measure = get_vector_measure(name)
        vectors = np.stack([measure.vector(signature.descriptors) for signature in signatures])
        own = np.arange(len(labels))
        assert figures == pytest.approx(vars(evaluate(measure.matrix(vectors), labels, labels, own=own).metrics))
    assert reported["spectrum"]["nn"] == 1.0
    assert done.stderr == ""


def test_an_evaluation_against_a_gallery_prints_the_accuracy(folder, tmp_path):
    (tmp_path / "queries.csv").write_text(
        "class,path\nsheets,sheets/rolled.ply\nsheets,rings/thin.ply\nrings,bad.off\n"
    )
    (tmp_path / "gallery.csv").write_text("path,class\nsheets/flat.ply,sheets\nrings/thick.ply,rings\n")
    (folder / "bad.off").write_bytes(DAMAGED)
    try:
        done = unbend(
            "evaluate", folder, "--labels", tmp_path / "queries.csv", "--gallery", tmp_path / "gallery.csv",
            "--json", "--measure", "spectrum", "--measure", "moments",
        )  # fmt: skip
    finally:
        (folder / "bad.off").unlink()
    assert done.returncode == 0
    third = {"accuracy": pytest.approx(1 / 3)}
    assert json.loads(done.stdout) == {"spectrum": third, "moments": third}
    assert done.stderr.startswith(f"{folder / 'bad.off'}: ")


def test_evaluation_by_class_adds_classes_confusions_and_curves_to_its_json(folder):
    options = ["--labels", folder / "labels.csv", "--json", "--samples", 40, "--measure", "spectrum"]
    reported = json.loads(succeeded("evaluate", folder, *options, "--per-class", run=in_process).stdout)
    signatures = [compute_signature(read_mesh(folder / name), Parameters(**SAMPLES)) for name in MEMBERS]
    labels = [name.split("/")[0] for name in MEMBERS]
    measure = get_vector_measure("spectrum")
    distances = measure.matrix(np.stack([measure.vector(signature.descriptors) for signature in signatures]))
    assert reported == {"spectrum": evaluate(distances, labels, labels, own=np.arange(5)).as_dict()}
    assert set(reported["spectrum"]) > FIGURES | {"classes", "confusion", "precision_recall"}


def test_evaluation_by_class_against_a_gallery_counts_files_that_fail_in_their_class(folder, tmp_path):
    (tmp_path / "bad.off").write_bytes(DAMAGED)
    (tmp_path / "queries.csv").write_text(f"path,class\nsheets/rolled.ply,sheets\n{tmp_path}/bad.off,rings\n")
    (tmp_path / "gallery.csv").write_text("path,class\nsheets/flat.ply,sheets\nrings/thick.ply,rings\n")
    command = ["evaluate", folder, "--labels", tmp_path / "queries.csv", "--gallery", tmp_path / "gallery.csv"]
    reported = succeeded(*command, "--per-class", "--measure", "moments", run=in_process).stdout
    sentence, overall, classes = (part.splitlines() for part in reported.split("\n\n"))
    assert sentence == ["moments: 1 of 2 nearest shapes have the class of the query"]
    assert overall[0].split() == ["measure", "accuracy", "nn", "ft", "st", "e", "dcg", "map"]
    assert overall[1].split()[:3] == ["moments", "0.500", "1.000"]
    assert classes[0].split()[:4] == ["moments", "queries", "members", "accuracy"]
    assert classes[1].split() == ["rings", "1", "1", "0.000", "-", "-", "-", "-", "-", "-"]
    assert classes[2].split()[:5] == ["sheets", "1", "1", "1.000", "1.000"]


def test_an_evaluation_counts_unreadable_queries_as_wrong(folder, tmp_path):
    (tmp_path / "bad.off").write_bytes(DAMAGED)
    (tmp_path / "bad.csv").write_text(f"path,class\n{tmp_path}/bad.off,rings\n")
    (tmp_path / "good.csv").write_text("path,class\nsheets/flat.ply,sheets\n")
    bad, good = tmp_path / "bad.csv", tmp_path / "good.csv"
    command = ["evaluate", folder, "--measure", "moments", "--json"]
    assert json.loads(in_process(*command, "--labels", bad, "--gallery", good).stdout) == {"moments": {"accuracy": 0.0}}
    done = in_process(*command, "--labels", good, "--gallery", bad)
    assert (done.returncode, done.stdout) == (1, "")
    assert "unbend: none of the gallery's files can be used" in done.stderr


def test_an_evaluation_writes_an_escaped_html_page(folder, tmp_path):
    name = "<script>alert(1)<.ply"
    (tmp_path / name).write_bytes((folder / "rings/thin.ply").read_bytes())
    (tmp_path / f"{name}.off").write_bytes(DAMAGED)
    rows = [f"{folder}/{member},{member.split('/')[0]}" for member in MEMBERS]
    (tmp_path / "l.csv").write_text("\n".join(["path,class", *rows, f"{name},sheets", f"{name}.off,rings"]))
    done = in_process("evaluate", tmp_path, "--labels", tmp_path / "l.csv", "--html", tmp_path / "r.html", "--json")
    assert done.returncode == 0
    reported = json.loads(done.stdout)
    assert all(set(figures) == FIGURES for figures in reported.values())
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "<script" not in page
    assert "&lt;script&gt;alert(1)&lt;.ply.off</bdi>" in page  # listed as unreadable
    assert "&lt;script&gt;alert(1)&lt;.ply</bdi>" in page  # listed as misclassified, because it is a ring
    for measure, figures in reported.items():
        assert f"<bdi>{measure}</bdi>" in page
        assert f">{figures['map']:.3f}<" in page
    assert "each of 6 shapes" in page
    for setting, value in (Parameters().as_dict() | MeshPolicy().as_dict()).items():
        assert f"<bdi>{setting}</bdi></th><td><bdi>{'none' if value is None else value}</bdi>" in page


def test_a_report_has_a_picture_of_each_file_that_can_be_used(folder, tmp_path):
    (tmp_path / "bad.off").write_bytes(DAMAGED)
    rows = [f"{name},{name.split('/')[0]}" for name in MEMBERS]
    (tmp_path / "l.csv").write_text("\n".join(["path,class", *rows, f"{tmp_path}/bad.off,rings"]))
    asked = ["evaluate", folder, "--labels", tmp_path / "l.csv", "--measure", "moments", "--html", tmp_path / "r.html"]
    succeeded(*asked, run=in_process)
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    files = [base64.b64decode(found) for found in re.findall(r'href="data:image/webp;base64,([^"]+)"', page)]
    request = PictureRequest(width=128, height=128, format="webp", theme="transparent")
    assert sorted(files) == sorted(render_picture(request, read_mesh(folder / name)) for name in MEMBERS)
    for name in MEMBERS:
        assert f"<title>{name}, of class {name.split('/')[0]}</title>" in page
    for file in files:
        alpha = np.asarray(Image.open(io.BytesIO(file)).convert("RGBA"))[..., 3]
        assert alpha.shape == (128, 128)
        assert alpha[0, 0] == 0
        assert (alpha == 255).any()


def test_an_evaluation_prints_a_table_of_the_chosen_measures(folder):
    lines = succeeded(
        "evaluate", folder, "--labels", folder / "labels.csv", "--measure", "moments", run=in_process
    ).stdout.splitlines()
    assert lines.pop(0) == "moments: 5 of 5 nearest shapes have the class of the query"
    assert lines.pop(0) == ""
    assert lines[0].split() == ["measure", "nn", "ft", "st", "e", "dcg", "map"]
    assert [line.split()[0] for line in lines[1:]] == ["moments"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("path,label\nsheets/flat.ply,a\n", ["'class'"]),
        ("file,class\nsheets/flat.ply,a\n", ["'path'"]),
        ("", ["no column"]),
        ("path,class\n", ["no rows"]),
        ("path,class\n,a\n", ["line 2", "empty"]),
        ("path,class\nsheets/flat.ply,caf\udce9\n", []),
        ("path,class\n" + "x" * 200_000 + ",a\n", []),
    ],
    ids=["no class", "no path", "empty", "no rows", "no name", "not UTF-8", "long field"],
)
@pytest.mark.parametrize("command", ["evaluate", "import"])
def test_an_invalid_file_of_labels_fails_with_one_line(folder, tmp_path, command, text, words):
    labels = tmp_path / "labels.csv"
    labels.write_bytes(text.encode(errors="surrogateescape"))
    library = ["--library", tmp_path / "library.db"] if command == "import" else []
    failed_with_a_sentence(in_process(command, folder, "--labels", labels, *library), "labels.csv", *words)


def test_an_evaluation_needs_every_labelled_file(folder, tmp_path):
    labels = tmp_path / "labels.csv"
    labels.write_text("path,class\nsheets/flat.ply,a\nnowhere.ply,b\n")
    failed_with_a_sentence(in_process("evaluate", folder, "--labels", labels), "labels.csv, line 3", "nowhere.ply")


def test_files_without_a_class_are_imported_without_a_label_and_not_evaluated(folder, tmp_path):
    labels = tmp_path / "labels.csv"
    rows = [f"{name},{'' if name.endswith('shut.ply') else Path(name).parent}" for name in MEMBERS]
    labels.write_text("\n".join(["path,class", *rows]))
    succeeded("import", folder, "--labels", labels, "--library", tmp_path / "a.db", run=in_process)
    with Library(str(tmp_path / "a.db")) as opened:
        assert (len(opened), opened.labels()) == (5, {"sheets": 2, "rings": 2})
    command = ["evaluate", folder, "--labels", labels, "--measure", "moments", "--per-class", "--samples", 40]
    done = succeeded(*command, run=in_process)
    assert "1 of 5 files has no class and is left out" in done.stderr
    assert [line.split()[:2] for line in done.stdout.split("\n\n")[2].splitlines()[1:]] == [
        ["rings", "2"],
        ["sheets", "2"],
    ]
    labels.write_text("path,class\nsheets/flat.ply,\n")
    failed_with_a_sentence(in_process("evaluate", folder, "--labels", labels), "no row has a class")


def test_an_exported_library_can_be_imported_and_evaluated(library, tmp_path):
    out = tmp_path / "out"
    assert succeeded("export", out, "--library", library, run=in_process).stdout == f"{out}: 5 shapes\n"
    labels = ["--labels", out / "labels.csv"]
    succeeded("import", out, *labels, "--library", tmp_path / "other.db", run=in_process)
    with Library(library) as one, Library(str(tmp_path / "other.db")) as other:
        reported = [
            [(shape.name, shape.label, shape.sha256) for shape in opened.page().items] for opened in (one, other)
        ]
        assert reported[0] == reported[1]
    figures = json.loads(succeeded("evaluate", out, *labels, "--measure", "moments", "--json", run=in_process).stdout)
    with Library(library) as one:
        assert figures["moments"] == pytest.approx(vars(one.evaluate("moments")))
    failed_with_a_sentence(in_process("export", out, "--library", library), "not an empty folder")


def test_a_library_is_backed_up_and_restored(library, tmp_path):
    copy, other = tmp_path / "copy.db", tmp_path / "other.db"
    reported = succeeded("backup", copy, "--library", library).stdout
    assert reported == f"{copy}: 5 shapes, {copy.stat().st_size} bytes, checked\n"
    assert succeeded("restore", copy, "--library", other, run=in_process).stdout == f"{other}: 5 shapes, as in {copy}\n"
    with Library(library) as one, Library(str(other)) as restored:
        assert one.page().items == restored.page().items
    failed_with_a_sentence(in_process("backup", copy, "--library", library), "exists already")
    failed_with_a_sentence(in_process("restore", copy, "--library", other), "would be replaced")
    succeeded("backup", copy, "--library", library, "--force", run=in_process)
    succeeded("restore", copy, "--library", other, "--force", run=in_process)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("signature {new}/bad.off", ["ends early"]),
        ("signature {closed} -o {new}/x.step", ["step"]),
        ("signature {closed} -o {new}/nowhere/x.ply", ["nowhere"]),
        ("signature {closed} --samples 3", ["samples"]),
        ("signature {closed} --max-vertices 3", ["max_vertices"]),
        ("compare {mesh} {mesh} --dimensions 0", ["dimensions"]),
        ("compare {mesh} {mesh} --max-vertices 0", ["max_vertices"]),
        ("import {folder} --library {new}/a.db --samples 3", ["samples"]),
        ("keys list --library ~nobody-of-this-name/x.db", ["there is no such user"]),
        ("serve --port 0 --library ~nobody-of-this-name/x.db", ["there is no such user"]),
        ("evaluate {folder} --labels {folder}/labels.csv --max-vertices 3", ["max_vertices"]),
        ("evaluate {folder} --labels {folder}/labels.csv --html {new}/nowhere/x.html", ["nowhere"]),
        ("query {mesh} --library {new}/nowhere/a.db", ["no library"]),
        ("import {folder} --library {new}/nowhere/a.db", ["cannot be opened"]),
        ("query {mesh} --library {new}/letter.db", ["cannot be opened"]),
        ("query {mesh} --library nosuchdatabase://host/x", ["nosuchdatabase"]),
        ("query {mesh} --url http://127.0.0.1:9", ["could not be reached"]),
        ("query {mesh} --url http://host:port", ["port"]),
        ("import {folder} --url http://127.0.0.1:9", ["could not be reached"]),
        ("import {new}/empty --library {new}/a.db", ["no file"]),
        ("export {new}/out --library {new}/nowhere.db", ["no library"]),
        ("backup {new}/copy.db --library {new}/nowhere.db", ["no library"]),
        ("backup {new}/copy.db --library {new}/letter.db", ["not a database"]),
        ("backup {new}/copy.db --library postgresql://host/shapes", ["pg_dump"]),
        ("backup {new}/nowhere/copy.db --library {new}/letter.db", ["no folder"]),
        ("restore {new}/letter.db --library {new}/a.db", ["not a library"]),
        ("restore {new}/nowhere.db --library {new}/a.db", ["no file"]),
    ],
)
def test_every_error_is_one_clear_line(folder, tmp_path, command, words):
    (tmp_path / "bad.off").write_bytes(DAMAGED)
    (tmp_path / "empty").mkdir()
    (tmp_path / "letter.db").write_bytes(b"no database " * 200)
    names = {"mesh": folder / "sheets/flat.ply", "closed": folder / "rings/thin.ply", "folder": folder, "new": tmp_path}
    failed_with_a_sentence(in_process(*(part.format(**names) for part in command.split())), *words)


def test_an_error_of_a_process_is_one_clear_line(tmp_path):
    (tmp_path / "bad.off").write_bytes(DAMAGED)
    failed_with_a_sentence(unbend("signature", tmp_path / "bad.off"), "ends early")


def test_wrong_usage_has_exit_status_2(folder, tmp_path):
    failed_with_a_sentence(in_process("signature", tmp_path / "none.ply"), "none.ply", status=2)
    both = in_process("import", folder, "--labels", folder / "labels.csv", "--label-from", "folder")
    failed_with_a_sentence(both, "exclude each other", status=2)
    mesh = folder / "sheets/flat.ply"
    failed_with_a_sentence(in_process("compare", mesh, mesh, "--measure", "volume"), "volume", "spectrum", status=2)


@pytest.mark.parametrize("name", ["UNBEND_WORKERS", "UNBEND_MAX_QUEUED", "UNBEND_JOB_SECONDS"])
def test_a_server_with_an_invalid_setting_does_not_start_and_names_it(name):
    done = in_process("serve", "--port", 0, **{name: "-1"})
    assert done.returncode == 1
    assert name in done.stderr
    assert "Traceback" not in done.stderr


def test_a_server_whose_library_cannot_be_opened_exits_with_a_message(tmp_path):
    done = unbend("serve", "--port", 0, "--library", tmp_path / "nowhere/a.db")
    assert done.returncode not in {0, None}
    assert "cannot be opened" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("name", "value"),
    [("UNBEND_OPEN", "perhaps"), ("UNBEND_CORS_ORIGINS", "https://a.example/path"), ("UNBEND_CORS_ORIGINS", "a")],
)
def test_an_invalid_access_setting_is_named(name, value):
    done = in_process("serve", "--port", 0, **{name: value})
    assert done.returncode == 1
    assert name in done.stderr


@pytest.mark.parametrize("host", ["0.0.0.0", "::", ""])  # noqa: S104
def test_a_library_without_keys_is_not_served_to_other_machines(tmp_path, host):
    done = in_process("serve", "--host", host, "--port", 0, "--library", tmp_path / "a.db")
    assert done.returncode == 1
    assert "the library has no keys" in done.stderr
    assert "unbend keys create" in done.stderr


def test_a_key_is_shown_once_then_listed_and_revoked(tmp_path):
    library = ("--library", tmp_path / "a.db")
    with Library(str(tmp_path / "a.db")):
        pass
    assert "no keys" in succeeded("keys", "list", *library, run=in_process).stdout
    done = succeeded("keys", "create", "scanner", "--scope", "write", *library, run=in_process)
    (text,) = done.stdout.split()
    prefix, key_id, secret = text.split("_", 2)
    assert prefix == "unbend"
    assert secret not in done.stderr
    (reported,) = json.loads(succeeded("keys", "list", "--json", *library, run=in_process).stdout)["keys"]
    assert (reported["id"], reported["name"], reported["scope"], reported["revoked_at"]) == (
        key_id,
        "scanner",
        "write",
        None,
    )
    assert set(reported) == {"id", "name", "scope", "created_at", "revoked_at", "expires_at", "expired", "most_jobs"}
    assert "scanner" in succeeded("keys", "revoke", key_id, *library, run=in_process).stdout
    table = succeeded("keys", "list", *library, run=in_process).stdout
    assert key_id in table
    assert secret not in table
    assert json.loads(succeeded("keys", "list", "--json", *library, run=in_process).stdout)["keys"][0]["revoked_at"]
    failed_with_a_sentence(in_process("keys", "revoke", "nobody", *library), "no key nobody")
    failed_with_a_sentence(in_process("keys", "create", "", *library), "name")


def test_a_new_key_may_only_read_by_default(tmp_path):
    named = {"UNBEND_LIBRARY": str(tmp_path / "a.db")}
    succeeded("keys", "create", "x", run=in_process, **named)
    (reported,) = json.loads(succeeded("keys", "list", "--json", run=in_process, **named).stdout)["keys"]
    assert reported["scope"] == "read"


def test_commands_send_the_api_key_of_the_environment(folder, tmp_path):
    library = ("--library", tmp_path / "library.db")
    reader, writer = (
        succeeded("keys", "create", scope, "--scope", scope, *library, run=in_process).stdout.strip()
        for scope in ("read", "write")
    )
    options = ["--samples", 40]
    with Server(tmp_path, workers=1) as running:
        imports = ("import", folder / "sheets", "--url", running.url, *options)
        failed_with_a_sentence(in_process(*imports), "needs an API key")
        failed_with_a_sentence(in_process(*imports, UNBEND_API_KEY="unbend_x_y"), "no key of this library")
        failed_with_a_sentence(in_process(*imports, UNBEND_API_KEY=reader), "may only read")
        assert "3 of 3" in succeeded(*imports, run=in_process, UNBEND_API_KEY=writer).stdout
        query = ("query", folder / "sheets/flat.ply", "--url", running.url, "--json", *options)
        assert json.loads(succeeded(*query, run=in_process, UNBEND_API_KEY=reader).stdout)["shapes"]


def test_the_openapi_document_is_printed_and_written(tmp_path):
    committed = (Path(__file__).parents[2] / "openapi/openapi.json").read_text()
    assert succeeded("openapi", UNBEND_MAX_QUEUED="7").stdout == committed
    assert succeeded("openapi", "-o", tmp_path / "o.json", run=in_process).stdout == ""
    assert (tmp_path / "o.json").read_text() == committed


def test_the_demo_is_written_with_a_file_of_labels(tmp_path):
    done = succeeded("demo", "--write", tmp_path / "demo", run=in_process)
    lines = (tmp_path / "demo/labels.csv").read_text().splitlines()
    assert lines[0] == "path,class"
    assert done.stdout.startswith(f"{len(lines) - 1} demo shapes")
    names = {line.split(",")[0] for line in lines[1:]}
    assert {path.name for path in (tmp_path / "demo").glob("*.ply")} == names
    assert read_mesh(tmp_path / "demo" / min(names)).area > 0


def test_progress_is_shown_on_a_terminal_but_not_on_standard_output(folder, tmp_path):
    command = [sys.executable, "-m", "unbend", "import", folder, "--library", tmp_path / "a.db"]
    with (tmp_path / "out").open("wb") as out:
        status, shown = on_terminal(command, "stderr", stdout=out)
    assert status == 0
    assert (tmp_path / "out").read_bytes() == b"5 of 5 shapes imported: 5 new\n"
    assert "importing" in shown
