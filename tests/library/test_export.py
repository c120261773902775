"""Export of a library to files with safe names, and importing the files again."""

from __future__ import annotations

import csv
import json
import string
import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.server import ply, small_mesh
from tests.support.store import add, insert
from unbend import Library, Parameters
from unbend.cli.folders.files import read_labels
from unbend.errors import MeshFormatError, ParameterError
from unbend.library.backups.export import safe_name
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

COLUMNS = [
    "path", "class", "id", "name", "metadata", "sha256", "size", "parameters", "policy", "version", "created_at",
]  # fmt: skip

NAMES = {
    "cat": "cat", "../../etc/passwd": "_._.._etc_passwd", "/root": "_root", "a/b\\c": "a_b_c", ".hidden": "_hidden",
    "..": "_", "-rf": "_rf", "=1+1": "_1+1", "@x": "_x", "+1": "_1", "~": "_", "con": "_con", "LPT1.x": "_LPT1.x",
    "Käse 猫 ": "Käse 猫",
    "Ka\u0308se": "Käse", "two\nlines\r\x00": "two_lines__", 'a"b,c;d': "a_b,c;d", "v1.2": "v1.2",
    "\u202egnp.exe": "_gnp.exe", "ends. .": "ends",
}  # fmt: skip


def rows_of(folder) -> list[dict[str, str]]:
    with (folder / "labels.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(("name", "safe"), NAMES.items())
def test_file_names_are_the_names_of_shapes_with_unsafe_characters_replaced(name, safe):
    assert safe_name(name) == safe


@settings(max_examples=50)
@given(st.text(min_size=1, max_size=80))
def test_any_name_becomes_a_safe_file_name(name):
    safe = safe_name(name)
    assert 1 <= len(safe.encode()) <= 151
    assert not set(safe) & set('/\\:*?"<>|' + "".join(map(chr, range(32))))
    assert safe[0] not in ".-~=+@" + string.whitespace
    assert safe[-1] not in ". "


def test_an_export_contains_every_file_and_the_whole_record(library, tmp_path):
    off, obj = (
        write_mesh(torus(columns=9, rows=5).vertices, torus(columns=9, rows=5).faces, kind) for kind in ("off", "obj")
    )
    few = Parameters(samples=30)
    records = [
        library.add(off, name="ring", label="tori, round", metadata={"täg": [1, None]}, parameters=few),
        library.add(obj, name="ring", label='=cmd|"x"', parameters=few),
        library.add(ply(torus(columns=8, rows=5)), name="no/label\n", parameters=few),
    ]
    out = tmp_path / "new/out"
    assert library.export(out) == 3
    assert {file.name for file in out.iterdir()} == {"labels.csv", "ring.off", "ring.obj", "no_label_.ply"}
    reported = rows_of(out)
    assert (out / "labels.csv").read_bytes().startswith(b"path,class,")
    for row, record in zip(reported, records, strict=True):
        assert list(row) == COLUMNS
        assert (out / row["path"]).read_bytes() == library.mesh(record.id)
        assert (row["class"], row["id"], row["name"]) == (record.label or "", record.id, record.name)
        assert (row["sha256"], int(row["size"])) == (record.sha256, record.size)
        assert json.loads(row["metadata"]) == record.metadata
        assert json.loads(row["parameters"]) == record.parameters.as_dict()
        assert json.loads(row["policy"]) == record.policy.as_dict()
    assert [file.label for file in read_labels(out / "labels.csv", out)] == ["tori, round", '=cmd|"x"', None]


def test_equal_names_get_different_files(library, tmp_path):
    names = ["cat", "cat", "a/b", "a:b", "cat"]
    records = [add(library, b"OFF %d" % number, name) for number, name in enumerate(names)]
    clash = add(library, b"OFF 9", f"cat-{records[4].id}")
    library.change(clash.id, name=f"cat-{records[4].id}")
    records.insert(0, add(library, b"OFF 10", "labels.csv"))
    out = tmp_path / "out"
    assert library.export(out) == 7
    reported = {row["id"]: row["path"] for row in rows_of(out)}
    assert len(set(reported.values())) == 7
    assert reported[records[1].id] == "cat.off"
    assert reported[records[2].id] == f"cat-{records[2].id}.off"
    for shape_id, path in reported.items():
        assert (out / path).read_bytes() == library.mesh(shape_id)


def test_a_name_that_contains_the_id_of_another_shape_gets_its_own_file(library, tmp_path):
    add(library, b"OFF 0", "cat")
    first = add(library, b"OFF 1", "to be renamed")
    second = add(library, b"OFF 2", "cat")
    library.change(first.id, name=f"cat-{second.id}")
    library.export(tmp_path / "out")
    assert sorted((file.name, file.read_bytes()) for file in (tmp_path / "out").glob("*.off")) == [
        (f"cat-{second.id}-2.off", b"OFF 2"), (f"cat-{second.id}.off", b"OFF 1"), ("cat.off", b"OFF 0"),
    ]  # fmt: skip


def test_an_export_into_a_folder_that_is_not_empty_is_refused(library, tmp_path):
    add(library, b"OFF 0", "cat")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine").write_text("x")
    (tmp_path / "file").write_text("x")
    for name in ("out", "file"):
        with pytest.raises(ParameterError, match="not an empty folder"):
            library.export(tmp_path / name)
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["mine"]
    (tmp_path / "out/mine").unlink()
    assert library.export(tmp_path / "out") == 1


def test_an_export_of_an_empty_library_has_only_a_header(library, tmp_path):
    assert library.export(tmp_path / "out") == 0
    assert (tmp_path / "out/labels.csv").read_text().splitlines() == [",".join(COLUMNS)]


def test_an_export_is_consistent_while_another_library_writes(library, path, tmp_path, monkeypatch):
    """Each change gives two shapes, which are pages apart, the same new name."""
    monkeypatch.setattr("unbend.library.backups.export.MAX_PAGE", 2)
    with library.store.write() as connection:
        ids = [insert(connection, b"OFF %d" % number, "x").id for number in range(99)]
    stop, changed = threading.Event(), []

    def change() -> None:
        with Library(str(path)) as other:
            while not stop.is_set():
                with other.store.write() as connection:
                    for shape_id in (ids[0], ids[-1]):
                        connection.exec_driver_sql(
                            "UPDATE shapes SET name = ? WHERE id = ?", (f"number {len(changed)}", shape_id)
                        )
                changed.append(True)

    thread = threading.Thread(target=change)
    thread.start()
    try:
        while not changed:
            pass
        before = len(changed)
        assert library.export(tmp_path / "out") == 99
        assert len(changed) > before
    finally:
        stop.set()
        thread.join()
    reported = rows_of(tmp_path / "out")
    assert reported[0]["name"] == reported[-1]["name"]
    assert len({row["path"] for row in reported}) == len(reported)


def test_an_export_that_fails_has_no_file_of_labels(library, tmp_path):
    add(library, b"OFF 0", "cat")
    add(library, b"no mesh that we know", "unknown")
    with library.store.write() as connection:
        connection.exec_driver_sql("UPDATE signatures SET report = '{}'")
    with pytest.raises(MeshFormatError):
        library.export(tmp_path / "out")
    assert not (tmp_path / "out/labels.csv").exists()


def test_an_export_can_be_imported(library, tmp_path):
    few = Parameters(samples=30)
    for number, (name, label) in enumerate([("a/b", "x"), ("a:b", None), ("käse", "=y\n"), (".", "z,\r")]):
        library.add(small_mesh(number), name=name, label=label, parameters=few)
    library.export(tmp_path / "out")
    with Library(str(tmp_path / "other.db")) as other:
        for file in read_labels(tmp_path / "out/labels.csv", tmp_path / "out"):
            other.add(file.path, label=file.label, parameters=few)
        assert [(shape.sha256, shape.label) for shape in other.page().items] == [
            (shape.sha256, shape.label) for shape in library.page().items
        ]
