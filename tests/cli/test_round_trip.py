"""An exported library can be imported unchanged, into a library and into a service."""

from __future__ import annotations

import csv

import pytest

from tests.support.commands import in_process, succeeded
from tests.support.server import Server, small_mesh, two_rings
from tests.support.server import ply as as_ply
from unbend import Library, MeshPolicy, Parameters

FEW = Parameters(samples=40)
COMPARED = ("name", "label", "metadata", "sha256", "size", "parameters", "policy", "version", "area", "warnings")

SHAPES = [
    ("plain", "cat", {}),
    ("=1+1", "=SUM(A1)", {"a": [1, None, {"b": "c"}]}),
    ("two\nlines\r\n", 'quo"te,;\n', {"\u2028": "\u202e"}),
    ("../../etc/passwd", None, {}),
    ("K\u00e4se \U0001f9c0", "K\u00e4se", {"k": 1e300}),
    ("plain", "dog", {"number": 12345678901234567890}),
]


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """The export and the records of a library with unusual names, parameters and policies."""
    folder = tmp_path_factory.mktemp("original")
    with Library(str(folder / "a.db")) as library:
        for number, (name, label, metadata) in enumerate(SHAPES):
            library.add(small_mesh(number), name=name, label=label, metadata=metadata, parameters=FEW)
        for samples in (41, 42):
            library.add(small_mesh(0), name=f"with {samples}", parameters=Parameters(samples=samples))
        rings = as_ply(two_rings(1))
        for policy in (MeshPolicy(), MeshPolicy(components="bridge"), MeshPolicy(seams="keep")):
            library.add(rings, name="rings", label="a", parameters=FEW, policy=policy)
        library.export(folder / "out")
        return folder / "out", compared_fields(library.page(limit=500).items)


def compared_fields(items) -> list[dict]:
    fields = [{name: getattr(item, name) for name in COMPARED} for item in items]
    return sorted(fields, key=repr)


def test_an_exported_library_is_imported_unchanged(original, tmp_path):
    folder, before = original
    arguments = ("import", folder, "--labels", folder / "labels.csv", "--library", tmp_path / "b.db")
    assert succeeded(*arguments, run=in_process).stdout == "11 of 11 shapes imported: 11 new\n"
    with Library(str(tmp_path / "b.db")) as library:
        assert compared_fields(library.page(limit=500).items) == before
    assert succeeded(*arguments, run=in_process).stdout == "11 of 11 shapes imported: 0 new, 11 unchanged\n"


def test_an_exported_library_is_imported_unchanged_over_http(original, tmp_path):
    folder, before = original
    with Server(tmp_path, workers=1) as server:
        arguments = ("import", folder, "--labels", folder / "labels.csv", "--url", server.url)
        assert succeeded(*arguments, run=in_process).stdout == "11 of 11 shapes imported: 11 new\n"
        with Library(str(server.library)) as library:
            assert compared_fields(library.page(limit=500).items) == before
        relabel(folder / "labels.csv", tmp_path / "labels.csv")
        again = ("import", folder, "--labels", tmp_path / "labels.csv", "--url", server.url)
        said = succeeded(*again, run=in_process).stdout
        assert said == "11 of 11 shapes imported: 0 new, 1 changed, 10 unchanged\n"


def relabel(source, target) -> None:
    with source.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    rows[0]["class"] = "corrected"
    with target.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def test_a_repeated_import_applies_corrected_labels(original, tmp_path):
    folder, _ = original
    library = ("--library", tmp_path / "b.db")
    succeeded("import", folder, "--labels", folder / "labels.csv", *library, run=in_process)
    relabel(folder / "labels.csv", tmp_path / "labels.csv")
    done = succeeded("import", folder, "--labels", tmp_path / "labels.csv", *library, run=in_process)
    assert done.stdout == "11 of 11 shapes imported: 0 new, 1 changed, 10 unchanged\n"
    with Library(str(tmp_path / "b.db")) as opened:
        assert opened.labels()["corrected"] == 1


def test_options_override_exported_parameters(original, tmp_path):
    folder, _ = original
    library = ("--library", tmp_path / "b.db")
    succeeded("import", folder, "--labels", folder / "labels.csv", *library, "--samples", 30, run=in_process)
    with Library(str(tmp_path / "b.db")) as opened:
        assert {shape.parameters.samples for shape in opened.page(limit=500).items} == {30}


def test_an_import_reports_duplicate_and_ignored_files(tmp_path):
    folder = tmp_path / "meshes"
    folder.mkdir()
    for name in ("a.ply", "b.ply"):
        (folder / name).write_bytes(small_mesh(1))
    (folder / "c").write_bytes(small_mesh(2))
    (folder / "labels.csv").write_text("path,class\na.ply,cat\n")
    done = succeeded("import", folder, "--samples", 40, "--library", tmp_path / "a.db", run=in_process)
    assert done.stdout == "2 of 2 shapes imported: 1 new, 1 merged\n"
    assert f"b.ply: has the same bytes as {folder / 'a.ply'}" in done.stderr
    assert "labels.csv exists, but is not read without --labels" in done.stderr
    assert "2 left out: not a mesh, such as c" in done.stderr


@pytest.mark.parametrize(("column", "text"), [("metadata", "[1]"), ("parameters", "{"), ("policy", "1")])
def test_invalid_json_in_a_file_of_labels_is_reported_with_its_line(tmp_path, column, text):
    (tmp_path / "a.ply").write_bytes(small_mesh(1))
    (tmp_path / "labels.csv").write_text(f"path,class,{column}\na.ply,cat,{text}\n")
    done = in_process("import", tmp_path, "--labels", tmp_path / "labels.csv", "--library", tmp_path / "a.db")
    assert done.returncode == 1
    assert f"labels.csv, line 2: {column}" in done.stderr
