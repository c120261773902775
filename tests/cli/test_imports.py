"""Imports of folders, and signatures of folders: interruptions, lost workers, and the account of every file."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from tests.support.commands import failed_with_a_sentence, in_process, succeeded
from tests.support.server import (
    DAMAGED,
    cpu_seconds,
    endless_mesh,
    is_running,
    ply,
    small_mesh,
    two_rings,
    without_settings,
    workers_of,
)
from unbend import Library, Parameters, compute_signature
from unbend.cli.folders.computing import Machine
from unbend.cli.folders.files import LabelledFile
from unbend.cli.folders.import_into_library import import_into_library
from unbend.cli.folders.import_options import ImportOptions
from unbend.mesh.shapes import torus

FEW = ["--samples", 8, "--method", "classical"]
QUICK = [*FEW, "--without-parts"]
MANY = 40
PATIENCE = 300.0


def rows_of(report: Path) -> list[dict]:
    if report.suffix == ".jsonl":
        return [json.loads(line) for line in report.read_text().splitlines()]
    with report.open(newline="") as file:
        return list(csv.DictReader(file))


def outcomes(report: Path) -> dict[str, str]:
    """Return the outcome of each path of a report, which has each path once."""
    rows = rows_of(report)
    found = {row["path"]: row["outcome"] for row in rows}
    assert len(found) == len(rows)
    return found


def counts_of(errors: str) -> tuple[int, list[tuple[int, str]]]:
    """Return the number of files and rows found, and the counts with their words, which add up to it."""
    lines = [re.fullmatch(r" +([\d,]+) (.*)", line) for line in errors.splitlines()]
    (found, words), *others = [(int(line[1].replace(",", "")), line[2]) for line in lines if line]
    named = re.fullmatch(r"files? found(?:, and (\d+) rows? without a file)?", words)
    assert named
    found += int(named[1] or 0)
    assert found == sum(count for count, _ in others)
    return found, others


@pytest.fixture(scope="module")
def mixed(tmp_path_factory) -> Path:
    """A folder with a file of every kind."""
    made = tmp_path_factory.mktemp("mixed")
    (made / "deep").mkdir()
    for number, name in enumerate(["a.ply", "b.ply", "deep/c.ply"]):
        (made / name).write_bytes(small_mesh(number))
    (made / "deep/copy.ply").write_bytes(small_mesh(0))
    (made / "apart.ply").write_bytes(ply(two_rings(1)))
    (made / "damaged.off").write_bytes(DAMAGED)
    (made / "notes.txt").write_text("no mesh")
    (made / ".hidden").write_text("no mesh")
    (made / "link").symlink_to(made / "deep")
    return made


EVERY = {
    "a.ply": "new", "b.ply": "new", "apart.ply": "new", "deep/c.ply": "new", "deep/copy.ply": "merged",
    "damaged.off": "failed", "notes.txt": "left out", ".hidden": "left out", "link": "left out",
}  # fmt: skip


@pytest.mark.parametrize(("place", "name"), [("library", "report.csv"), ("url", "report.jsonl")])
def test_an_import_accounts_for_every_file(mixed, tmp_path, server, place, name):
    where = ["--library", tmp_path / "a.db"] if place == "library" else ["--url", server.url]
    command = ("import", mixed, *where, *FEW, "--report", tmp_path / name)
    done = in_process(*command)
    assert (done.returncode, done.stdout) == (4, "5 of 6 shapes imported: 4 new, 1 merged\n")
    assert outcomes(tmp_path / name) == EVERY
    assert counts_of(done.stderr) == (9, [
        (4, "new"), (1, "merged: the same content as another file"), (1, "failed"),
        (2, "left out: not a mesh, such as .hidden"), (1, "left out: not a regular file, such as link"),
    ])  # fmt: skip
    assert "1 of the files has warnings" in done.stderr
    by_path = {row["path"]: row for row in rows_of(tmp_path / name)}
    assert by_path["deep/copy.ply"]["reason"] == str(mixed / "a.ply")
    assert by_path["deep/copy.ply"]["result"] == by_path["a.ply"]["result"] != ""
    assert "ends early" in by_path["damaged.off"]["reason"]
    assert "of the area was kept" in str(by_path["apart.ply"]["warnings"])
    again = in_process(*command)
    assert again.stdout == "5 of 6 shapes imported: 0 new, 4 unchanged, 1 merged\n"
    assert outcomes(tmp_path / name) == {
        path: "unchanged" if outcome == "new" else outcome for path, outcome in EVERY.items()
    }
    counts_of(again.stderr)


def test_rows_without_a_file_and_files_without_a_row_are_left_out(mixed, tmp_path):
    labels, report = tmp_path / "labels.csv", tmp_path / "report.csv"
    labels.write_text("path,class\na.ply,x\nnowhere.ply,y\ndeep/c.ply,z\n")
    command = ("import", mixed, "--labels", labels, "--library", tmp_path / "a.db", *QUICK, "--report", report)
    done = in_process(*command)
    assert (done.returncode, done.stdout) == (4, "2 of 2 shapes imported: 2 new\n")
    assert f"{labels}, line 3: there is no file {mixed / 'nowhere.ply'}" in done.stderr
    found, counts = counts_of(done.stderr)
    assert found == len(EVERY) + 1
    assert sorted(words.partition(",")[0] for _, words in counts) == [
        "left out: a mesh without a row in the file of labels", "left out: a row without a file",
        "left out: not a mesh", "left out: not a regular file", "new",
    ]  # fmt: skip
    reasons = {row["path"]: row["reason"] for row in rows_of(report)}
    assert reasons["nowhere.ply"] == "a row without a file"
    assert reasons["b.ply"] == "a mesh without a row in the file of labels"
    assert "        9 files found, and 1 row without a file\n" in done.stderr
    assert "a row without a file, such as nowhere.ply\n" in done.stderr
    labels.write_text("path,class\nnowhere/else.ply,y\n")
    refused = in_process(*command)
    assert refused.returncode == 1
    assert "such as nowhere/else.ply" not in refused.stderr
    assert refused.stderr.splitlines()[-2] == f"unbend: {labels}: no row names a file"


@pytest.mark.parametrize(("if_known", "outcome", "label"), [("update", "changed", "new"), ("keep", "unchanged", "old")])
def test_a_known_file_takes_or_ignores_another_class(tmp_path, if_known, outcome, label):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.ply").write_bytes(small_mesh(1))
    labels, report = tmp_path / "labels.csv", tmp_path / "report.jsonl"
    for named in ("old", "new"):
        labels.write_text(f"path,class\na.ply,{named}\n")
        done = succeeded(
            "import", tmp_path / "in", "--labels", labels, "--library", tmp_path / "a.db", *QUICK, "--if-known",
            if_known, "--report", report, run=in_process,
        )  # fmt: skip
    (row,) = rows_of(report)
    assert row["outcome"] == outcome
    assert (row["taken"], row["ignored"]) == ((["label"], []) if if_known == "update" else ([], ["label"]))
    assert f"{outcome}: known already, label {'taken' if if_known == 'update' else 'ignored'}" in done.stderr
    with Library(str(tmp_path / "a.db")) as library:
        assert library.labels() == {label: 1}


@pytest.mark.parametrize("place", ["library", "url"])
def test_an_empty_class_of_a_row_keeps_the_class_and_says_so(tmp_path, server, place):
    (tmp_path / "in/deep").mkdir(parents=True)
    (tmp_path / "in/deep/a.ply").write_bytes(small_mesh(700))
    labels, report = tmp_path / "labels.csv", tmp_path / "report.jsonl"
    where = ["--library", tmp_path / "a.db"] if place == "library" else ["--url", server.url]
    asked = ["import", tmp_path / "in", *where, *FEW]
    said = []
    for label in ("kept", ""):
        labels.write_text(f"path,class\ndeep/a.ply,{label}\n")
        said.append(succeeded(*asked, "--labels", labels, "--report", report, run=in_process).stderr)
    assert "        1 file found\n" in said[0]
    words = "class kept because the row has none"
    assert f"unchanged: known already, {words}, such as deep/a.ply\n" in said[1]
    (row,) = rows_of(report)
    assert (row["outcome"], row["reason"]) == ("unchanged", words)
    listed = json.loads(succeeded("show", row["result"], *where, "--json", run=in_process).stdout)
    assert listed["label"] == "kept"
    assert words not in succeeded(*asked, run=in_process).stderr  # nobody named a class


@pytest.mark.parametrize("place", ["library", "url"])
def test_the_first_of_equal_files_gives_the_class_in_every_import(tmp_path, server, place):
    for number, label in enumerate("ab"):
        (tmp_path / label).mkdir()
        (tmp_path / label / f"{number}.ply").write_bytes(small_mesh(500))
    report = tmp_path / "report.jsonl"
    where = ["--library", tmp_path / "a.db"] if place == "library" else ["--url", server.url]
    command = ("import", tmp_path, *where, *FEW, "--label-from", "folder", "--report", report)
    for first in ("new", "unchanged"):
        done = succeeded(*command, run=in_process)
        found = {row["path"]: (row["outcome"], row["ignored"]) for row in rows_of(report)}
        meshes = {path: outcome for path, outcome in found.items() if path.endswith(".ply")}
        assert meshes == {"a/0.ply": (first, []), "b/1.ply": ("merged", ["label"])}
        assert "both are one shape; its label is ignored" in done.stderr


def test_files_of_the_library_and_the_report_are_not_part_of_the_folder(tmp_path):
    (tmp_path / "a.ply").write_bytes(small_mesh(1))
    report = tmp_path / "report.csv"
    for _ in range(2):
        succeeded("import", tmp_path, "--library", tmp_path / "a.db", *QUICK, "--report", report, run=in_process)
        assert set(outcomes(report)) == {"a.ply"}


def test_a_link_to_an_impossible_name_is_left_out(tmp_path):
    (tmp_path / "link.ply").symlink_to("n" * 300)
    done = in_process("import", tmp_path, "--library", tmp_path / "a.db", *QUICK)
    failed_with_a_sentence(done, "there is no file that ends in")


@pytest.mark.parametrize("place", ["library", "url"])
def test_a_description_that_cannot_be_stored_fails_only_its_file(tmp_path, server, place):
    for number, name in enumerate("ab"):
        (tmp_path / f"{name}.ply").write_bytes(small_mesh(700 + number))
    labels = tmp_path / "labels.csv"
    labels.write_text(f"path,class\na.ply,{'x' * 300}\nb.ply,x\n")
    where = ["--library", tmp_path / "a.db"] if place == "library" else ["--url", server.url]
    done = in_process("import", tmp_path, "--labels", labels, *where, *FEW)
    assert (done.returncode, done.stdout) == (4, "1 of 2 shapes imported: 1 new\n")
    assert f"{tmp_path / 'a.ply'}: " in done.stderr


class Failing(BaseHTTPRequestHandler):
    """A service that accepts uploads, and then fails."""

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        self._respond(202, b'{"id": "1", "kind": "shape", "state": "queued"}')

    def do_GET(self) -> None:
        self._respond(500, b"")

    def _respond(self, status: int, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


def test_the_failure_of_a_service_ends_an_import_instead_of_failing_every_file(tmp_path):
    for number in range(2):
        (tmp_path / f"{number}.ply").write_bytes(small_mesh(number))
    with HTTPServer(("127.0.0.1", 0), Failing) as failing:
        thread = threading.Thread(target=failing.serve_forever)
        thread.start()
        done = in_process("import", tmp_path, "--url", f"http://127.0.0.1:{failing.server_port}", *FEW)
        failing.shutdown()
        thread.join()
    failed_with_a_sentence(done, "responded 500")


def test_an_import_without_parts_is_completed_later(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.ply").write_bytes(small_mesh(1))
    library = ["--library", tmp_path / "a.db"]
    succeeded("import", tmp_path / "in", *library, *QUICK, run=in_process)
    done = succeeded("complete", *library, run=in_process)
    assert (done.stdout, done.stderr) == ("completed 1 shape\n", "a\n")
    refused = in_process("import", tmp_path / "in", "--url", "http://127.0.0.1:9", "--without-parts")
    failed_with_a_sentence(refused, "exclude each other", status=2)


def test_a_shape_that_is_removed_meanwhile_fails_only_its_file(tmp_path):
    path, library = tmp_path / "a.ply", str(tmp_path / "a.db")
    path.write_bytes(small_mesh(1))
    parameters = {"samples": 8, "method": "classical"}
    options = ImportOptions(parameters, {}, "update", with_parts=False, machine=Machine(1, None))
    with Library(library) as other:
        shape = other.add(path, parameters=parameters)

        def files() -> Iterator[LabelledFile]:
            yield LabelledFile(path, "ring")
            other.remove(shape.id)

        (ended,) = import_into_library(library, files(), 1, options)
    assert (ended.outcome, ended.path) == ("failed", path)
    assert "was removed" in ended.reason


# Processes


@pytest.fixture(scope="module")
def many(tmp_path_factory) -> Path:
    """A folder of many meshes, each of which takes a moment."""
    made = tmp_path_factory.mktemp("many")
    for number in range(MANY):
        (made / f"{number:02d}.ply").write_bytes(ply(torus(minor=0.2 + 0.001 * number, columns=80, rows=50)))
    return made


class Command:
    """An import that runs, with its report."""

    def __init__(self, folder: Path, library: Path, *options: object) -> None:
        self.report = library.with_suffix(".csv")
        self.report.unlink(missing_ok=True)
        # A shell lets commands in the background ignore SIGINT, and the import would inherit that.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        command = [sys.executable, "-m", "unbend", "import", folder, "--library", library, *options]
        self.process = subprocess.Popen(
            [*map(str, command), "--report", str(self.report)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, env=without_settings(), start_new_session=True,
        )  # fmt: skip

    def until(self, is_reached, what: str):
        begun = time.monotonic()
        while time.monotonic() - begun < PATIENCE:
            if found := is_reached():
                return found
            assert self.process.poll() is None, self.process.communicate()
            time.sleep(0.02)
        raise AssertionError(f"no {what}")

    def ended_rows(self) -> int:
        return len(self.report.read_text().splitlines()) - 1 if self.report.exists() else 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_import_continues_without_computing_twice(many, tmp_path, number):
    library = tmp_path / "a.db"
    command = Command(many, library, *QUICK, "--workers", 3)
    command.until(lambda: command.ended_rows() >= 5, "stored shapes")
    workers = workers_of(command.process.pid)
    assert len(workers) == 3
    # A terminal sends SIGINT to the whole group.
    (os.killpg if number == signal.SIGINT else os.kill)(command.process.pid, number)
    out, errors = command.process.communicate(timeout=PATIENCE)
    begun = time.monotonic()
    while any(map(is_running, workers)):
        assert time.monotonic() - begun < PATIENCE
        time.sleep(0.02)
    if number == signal.SIGINT:
        assert (command.process.returncode, out) == (130, "")
        assert errors.splitlines()[-1].startswith("unbend: interrupted; what is stored stays, and the same command")
        found, counts = counts_of(errors)
        assert found == MANY
        assert [words for _, words in counts] == ["new", "not reached"]
    before = outcomes(command.report)
    with Library(str(library)) as opened:
        stored = len(opened)
    assert 5 <= len(before) <= stored < MANY  # SIGKILL may come between storing and reporting
    report = tmp_path / "again.csv"
    done = succeeded("import", many, "--library", library, *QUICK, "--report", report, run=in_process)
    assert done.stdout == f"{MANY} of {MANY} shapes imported: {MANY - stored} new, {stored} unchanged\n"
    after = outcomes(report)
    assert {after[path] for path in before} == {"unchanged"}
    assert len(after) == MANY


def test_a_file_that_kills_its_worker_costs_only_itself(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.ply").write_bytes(endless_mesh())
    for number in range(3):
        (tmp_path / f"in/b{number}.ply").write_bytes(small_mesh(number))
    command = Command(tmp_path / "in", tmp_path / "a.db", "--samples", 2000, "--without-parts", "--workers", 1)

    def computing() -> int | None:
        """Return the worker, once it has used much more time than it needs to start."""
        return next((pid for pid in workers_of(command.process.pid) if cpu_seconds(pid) > 5), None)

    os.kill(command.until(computing, "worker"), signal.SIGKILL)
    # The other meshes have too few vertices for so many samples only if they are read, in another process.
    _, errors = command.process.communicate(timeout=PATIENCE)
    assert command.process.returncode == 4
    assert "a.ply: the process that ran the job died" in errors
    assert outcomes(command.report)["a.ply"] == "failed"
    assert Counter(outcomes(command.report).values()) == {"failed": 1, "new": 3}


def test_a_file_that_exceeds_memory_costs_only_itself(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.ply").write_bytes(ply(torus(columns=1500, rows=700)))
    (tmp_path / "in/b.ply").write_bytes(small_mesh(1))
    options = (*QUICK, "--workers", 1, "--memory-mb", 1024)
    done = in_process("import", tmp_path / "in", "--library", tmp_path / "a.db", *options)
    assert (done.returncode, done.stdout) == (4, "1 of 2 shapes imported: 1 new\n")
    assert "a.ply: the mesh needs more memory" in done.stderr


# Signatures


def test_signatures_of_a_folder_are_those_of_its_files(mixed, tmp_path):
    out, report = tmp_path / "out", tmp_path / "report.csv"
    done = in_process("signature", mixed, "-o", out, *FEW, "--report", report)
    assert (done.returncode, done.stdout) == (4, "5 of 6 signatures written: 5 new\n")
    assert outcomes(report) == EVERY | {"deep/copy.ply": "new"}
    assert counts_of(done.stderr)[0] == len(EVERY)
    files = sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())
    assert files == ["a.ply.json", "apart.ply.json", "b.ply.json", "deep/c.ply.json", "deep/copy.ply.json"]
    expected = compute_signature(mixed / "deep/c.ply", Parameters(samples=8, method="classical"))
    assert json.loads((out / "deep/c.ply.json").read_text())["points"] == expected.points.tolist()
    results = {row["path"]: row["result"] for row in rows_of(report)}
    assert results["a.ply"] == str(out / "a.ply.json")


def test_several_meshes_keep_their_places_below_their_common_folder(mixed, tmp_path):
    (tmp_path / "in").symlink_to(mixed)
    meshes = (tmp_path / "in/a.ply", tmp_path / "in/deep")
    out = tmp_path / "in/deep/out"
    options = ("-o", out, "--format", "ply", "--whole", *FEW)
    for _ in range(2):  # the output of the first run is not part of the input of the second
        assert succeeded("signature", *meshes, *options, run=in_process).stdout == "3 of 3 signatures written: 3 new\n"
    assert sorted(path.name for path in out.rglob("*.ply")) == ["a.ply.ply", "c.ply.ply", "copy.ply.ply"]
    assert (out / "deep/c.ply.ply").is_file()
    for path in sorted(out.rglob("*"), reverse=True):
        path.unlink() if path.is_file() else path.rmdir()
    out.rmdir()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["{folder}"], "need a folder"),
        (["{folder}", "-o", "{folder}/a.ply"], "is not a folder"),
        (["{folder}/a.ply", "-o", "{folder}"], "is a folder"),
        (["{folder}/a.ply", "--format", "ply"], "are for several meshes"),
    ],
)
def test_the_output_of_signatures_suits_their_number(mixed, options, words):
    done = in_process("signature", *(option.format(folder=mixed) for option in options))
    failed_with_a_sentence(done, words, status=2)
