"""Signatures computed in shards, and imported: the library is that of an import of the folder."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import failed_with_a_sentence, in_process, succeeded
from tests.support.server import DAMAGED, is_running, ply, small_mesh, two_rings, without_settings, workers_of
from tests.support.shards import accepted, forged
from unbend import Library
from unbend.library.shards.numbering import ShardNumber
from unbend.mesh.shapes import torus

QUICK = ["--samples", 8, "--method", "classical", "--workers", 1]
FAST = [*QUICK, "--without-parts"]
MANY = 30
PATIENCE = 300.0


def rows_of(report: Path) -> dict[str, dict[str, str]]:
    with report.open(newline="") as file:
        return {row["path"]: row for row in csv.DictReader(file)}


def outcomes(report: Path) -> dict[str, str]:
    return {path: row["outcome"] for path, row in rows_of(report).items()}


def state_of(library: Path | str) -> list[dict]:
    """Return the shapes in the order of adding with all that is stored of them, except ids and times."""
    found = []
    with Library(str(library)) as opened:
        for shape in opened:
            signature = opened.signature(shape.id)
            arrays = (signature.points, signature.faces, signature.samples, signature.weights)
            vectors = {name: vector.tolist() for name, vector in sorted(signature.descriptors.items())}
            left_out = {"id", "created_at", "updated_at", "seq", "revision"}
            found.append(
                {name: value for name, value in shape.state.items() if name not in left_out}
                | {"arrays": [array.tolist() for array in arrays], "vectors": vectors, "mesh": opened.mesh(shape.id)}
            )
    return found


def distances_of(library: Path, measure: str) -> list[list[tuple[str, float]]]:
    with Library(str(library)) as opened:
        rankings = [opened.rank(shape.id, measure=measure).shapes for shape in opened]
    return [[(match.name, match.distance) for match in shapes] for shapes in rankings]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with equal files in different folders, a damaged file, and files that are no meshes."""
    made = tmp_path_factory.mktemp("meshes") / "in"
    for label in ("ant", "bee", "cat"):
        (made / label).mkdir(parents=True)
    for number in range(7):
        (made / "ant" / f"{number}.ply").write_bytes(small_mesh(number))
    for number in (2, 5, 8):
        (made / "bee" / f"copy-{number}.ply").write_bytes(small_mesh(number))
    (made / "cat/apart.ply").write_bytes(ply(two_rings(1)))
    (made / os.fsdecode(b"cat/\xe9.ply")).write_bytes(small_mesh(9))
    (made / "cat/damaged.off").write_bytes(DAMAGED)
    (made / "notes.txt").write_text("no mesh")
    return made


MESHES, COPIES = 12, 2
"""Meshes of the folder that can be computed, and those that are equal to another."""


@pytest.fixture(scope="module")
def shards(folder, tmp_path_factory) -> Path:
    """The shards of the folder, whose computation ends with status 4 where the damaged file is."""
    made = tmp_path_factory.mktemp("computed")
    reports = []
    for number in (1, 2, 3):
        report = made / f"{number}.csv"
        done = in_process(
            "compute", folder, "--out", made / "shards", "--shard", f"{number}/3", "--label-from", "folder", *QUICK,
            "--report", report,
        )  # fmt: skip
        found = outcomes(report)
        assert done.returncode == (4 if "cat/damaged.off" in found else 0), done.stderr
        reports.append(found)
    together = [path for report in reports for path in report]
    assert len(together) == len(set(together)) == MESHES + 2
    everything = {path: outcome for report in reports for path, outcome in report.items()}
    assert everything["cat/damaged.off"] == "failed"
    assert everything["notes.txt"] == "left out"
    return made / "shards"


def test_the_shards_of_a_folder_make_the_library_that_its_import_makes(folder, shards, tmp_path):
    options = ("--library", tmp_path / "shards.db", "--report", tmp_path / "report.csv")
    done = succeeded("import", shards, *options, run=in_process)
    assert done.stdout == f"{MESHES} of {MESHES} shapes imported: {MESHES - COPIES} new, {COPIES} merged\n"
    rows = rows_of(tmp_path / "report.csv")
    assert "bee/copy-2.ply: has the same bytes as ant/2.ply, so both are one shape" in done.stderr
    assert (rows["bee/copy-2.ply"]["outcome"], rows["bee/copy-2.ply"]["reason"]) == ("merged", "ant/2.ply")
    assert rows["cat/\\xe9.ply"]["outcome"] == "new"
    assert "of the area was kept" in rows["cat/apart.ply"]["warnings"]
    asked = ("import", folder, "--library", tmp_path / "folder.db", "--label-from", "folder", *QUICK)
    assert in_process(*asked).returncode == 4
    assert state_of(tmp_path / "shards.db") == state_of(tmp_path / "folder.db")
    for measure in ("spectrum", "rigid", "partial"):
        assert distances_of(tmp_path / "shards.db", measure) == distances_of(tmp_path / "folder.db", measure)
    again = succeeded("import", shards, *options, run=in_process)
    nothing = f"0 new, {MESHES - COPIES} unchanged, {COPIES} merged\n"
    assert again.stdout == f"{MESHES} of {MESHES} shapes imported: {nothing}"
    known = in_process("import", folder, "--library", tmp_path / "shards.db", "--label-from", "folder", *QUICK)
    assert known.stdout.endswith(nothing)


def test_shards_are_imported_into_postgresql_too(shards, postgres_url, tmp_path):
    for new in (MESHES - COPIES, 0):
        done = succeeded("import", shards, "--library", postgres_url, "--json", run=in_process)
        assert json.loads(done.stdout)["new"] == new
    succeeded("import", shards, "--library", tmp_path / "a.db", run=in_process)
    assert state_of(postgres_url) == state_of(tmp_path / "a.db")


def test_a_second_run_computes_nothing_and_writes_nothing(folder, shards, tmp_path):
    copied = tmp_path / "shards"
    shutil.copytree(shards, copied)
    before = {path.name: path.read_bytes() for path in copied.iterdir()}
    for share in ("1/3", "2/3", "3/3", "1/1", "1/2", "2/2"):  # another division finds the results, too
        done = in_process("compute", folder, "--out", copied, "--shard", share, "--label-from", "folder", *QUICK)
        assert " 0 new" in done.stdout
    assert {path.name: path.read_bytes() for path in copied.iterdir()} == before


def test_the_results_of_a_division_are_those_of_the_whole(folder, shards, tmp_path):
    in_process("compute", folder, "--out", tmp_path / "whole", "--label-from", "folder", *QUICK)
    (whole,) = (tmp_path / "whole").iterdir()
    shapes, files, errors = accepted([whole])
    divided, divided_files, _ = accepted(shards.iterdir())
    assert not errors
    assert divided == shapes
    assert {_without_time(file) for file in files} == {_without_time(file) for file in divided_files}


def _without_time(record: str) -> str:
    return json.dumps(json.loads(record) | {"written": 0.0})


def test_one_shard_can_be_imported_by_its_name(shards, tmp_path):
    path = min(shards.iterdir())
    done = succeeded("import", path, "--library", tmp_path / "a.db", "--json", run=in_process)
    assert json.loads(done.stdout)["new"] == len(accepted([path])[0])


def test_further_files_change_the_share_of_no_other(folder, shards, tmp_path):
    larger = tmp_path / "in"
    shutil.copytree(folder, larger)
    for number in range(5):
        (larger / f"ant/0{number}.ply").write_bytes(small_mesh(100 + number))
    shutil.copytree(shards, tmp_path / "shards")
    new = 0
    for number in (1, 2, 3):
        done = in_process(
            "compute", larger, "--out", tmp_path / "shards", "--shard", f"{number}/3", "--label-from", "folder", *QUICK,
            "--json",
        )  # fmt: skip
        new += json.loads(done.stdout)["new"]
    assert new == 5


# Labels


@pytest.fixture
def three(tmp_path) -> Path:
    made = tmp_path / "in"
    (made / "deep").mkdir(parents=True)
    for number, name in enumerate(("a.ply", "deep/b.ply", "c.ply")):
        (made / name).write_bytes(small_mesh(number))
    return made


def test_labels_of_the_computation_are_imported_and_changed_by_a_second_one(three, tmp_path):
    labels, library = tmp_path / "labels.csv", tmp_path / "a.db"
    labels.write_text('path,class,name,metadata\na.ply,x,A,"{""n"": 1}"\ndeep/b.ply,,,\nmissing.ply,x,,\n')
    asked = ("compute", three, "--out", tmp_path / "shards", "--labels", labels, *FAST)
    done = in_process(*asked)
    assert (done.returncode, done.stdout) == (4, "2 of 2 shapes computed: 2 new\n")
    succeeded("import", tmp_path / "shards", "--library", library, run=in_process)
    with Library(str(library)) as opened:
        assert [(s.name, s.label, s.metadata) for s in opened] == [("A", "x", {"n": 1}), ("b", None, {})]
    labels.write_text('path,class,name,metadata\na.ply,y,A,"{""n"": 1}"\ndeep/b.ply,,,\nc.ply,z,,\n')
    done = succeeded(*asked, run=in_process)
    assert done.stdout == "3 of 3 shapes computed: 1 new, 1 changed, 1 unchanged\n"
    assert "1 changed: known already, label taken" in done.stderr
    kept = succeeded("import", tmp_path / "shards", "--library", library, "--if-known", "keep", run=in_process)
    assert "1 unchanged: known already, label ignored" in kept.stderr
    changed = succeeded("import", tmp_path / "shards", "--library", library, run=in_process)
    assert changed.stdout == "3 of 3 shapes imported: 0 new, 1 changed, 2 unchanged\n"
    with Library(str(library)) as opened:
        assert opened.labels() == {"y": 1, "z": 1}


def test_labels_of_the_import_override_those_of_the_computation(three, tmp_path):
    labels, report = tmp_path / "labels.csv", tmp_path / "report.csv"
    succeeded("compute", three, "--out", tmp_path / "shards", "--label-from", "folder", *FAST, run=in_process)
    labels.write_text("path,class\n./c.ply,first\na.ply,second\nnowhere.ply,x\n")
    library = ("--library", tmp_path / "a.db")
    done = in_process("import", tmp_path / "shards", *library, "--labels", labels, "--report", report)
    assert (done.returncode, done.stdout) == (4, "2 of 2 shapes imported: 2 new\n")
    assert outcomes(report) == {"c.ply": "new", "a.ply": "new", "nowhere.ply": "left out", "deep/b.ply": "left out"}
    assert "line 4: there is no file nowhere.ply" in done.stderr
    with Library(str(tmp_path / "a.db")) as opened:
        assert [(shape.name, shape.label) for shape in opened] == [("c", "first"), ("a", "second")]
    succeeded("import", tmp_path / "shards", *library, "--label-from", "folder", run=in_process)
    with Library(str(tmp_path / "a.db")) as opened:
        assert {shape.name: shape.label for shape in opened} == {"a": "in", "c": "in", "b": "deep"}


def test_each_file_has_its_own_parameters_and_a_changed_file_its_new_results(three, tmp_path):
    labels, library = tmp_path / "labels.csv", ("--library", tmp_path / "a.db")
    labels.write_text('path,class,parameters\na.ply,x,"{""samples"": 9}"\nc.ply,x,\n')
    asked = ("compute", three, "--out", tmp_path / "shards", "--labels", labels)
    for samples in (7, 8):  # the results for other parameters stay
        succeeded(*asked, "--method", "classical", "--without-parts", run=in_process)
        labels.write_text(f'path,class,parameters\na.ply,x,"{{""samples"": {samples}}}"\nc.ply,x,\n')
    (three / "c.ply").write_bytes(small_mesh(7))
    done = succeeded(*asked, "--method", "classical", "--without-parts", run=in_process)
    assert done.stdout == "2 of 2 shapes computed: 2 new\n"
    succeeded("import", tmp_path / "shards", *library, run=in_process)
    with Library(str(tmp_path / "a.db")) as opened:
        assert sorted((shape.name, shape.parameters.samples) for shape in opened) == [
            ("a", 7), ("a", 8), ("a", 9), ("c", 300),
        ]  # fmt: skip
        assert {opened.mesh(shape.id) for shape in opened} == {small_mesh(0), small_mesh(7)}


# Faults


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Path:
    """One shard of two meshes."""
    made = tmp_path_factory.mktemp("small")
    (made / "in").mkdir()
    for number in range(2):
        (made / f"in/{number}.ply").write_bytes(small_mesh(number))
    succeeded("compute", made / "in", "--out", made / "shards", *FAST, run=in_process)
    return made / "shards"


def test_results_of_another_version_are_skipped_with_the_reason(small, tmp_path):
    def older(content, _):
        content["version"] = "4"

    (path,) = small.iterdir()
    made = forged(forged(path, tmp_path / "once", older), tmp_path / "shards", older, "file")
    done = in_process("import", tmp_path / "shards", "--library", tmp_path / "a.db")
    assert (done.returncode, done.stdout) == (4, "1 of 2 shapes imported: 1 new\n")
    assert "0.ply: the results are of version '4' of the algorithm, and this unbend has version '5'" in done.stderr
    assert made.exists()


def test_a_damaged_shard_is_reported_and_the_others_are_imported(small, tmp_path):
    (path,) = small.iterdir()
    data = bytearray(path.read_bytes())
    (tmp_path / "shards").mkdir()
    shutil.copy(path, tmp_path / "shards/2-of-2.0000.shard")
    damaged = tmp_path / "shards/1-of-2.0000.shard"
    data[40] ^= 1
    damaged.write_bytes(data)
    done = in_process("import", tmp_path / "shards", "--library", tmp_path / "a.db")
    assert (done.returncode, done.stdout) == (4, "2 of 2 shapes imported: 2 new\n")
    assert f"{damaged}, byte 0: the entry is damaged or incomplete. Remove {damaged}" in done.stderr
    again = in_process("compute", small.parent / "in", "--out", tmp_path / "shards", "--shard", "1/2", *FAST)
    failed_with_a_sentence(again, str(damaged), "byte 0")
    assert f"Remove {damaged}, and run" in again.stderr


def test_damage_within_a_result_costs_only_its_file(small, tmp_path):
    (path,) = small.iterdir()
    data = bytearray(path.read_bytes())
    data[data.index(b"end_header") + 20] ^= 1  # in the mesh of the first shape
    (tmp_path / "shards").mkdir()
    (tmp_path / "shards" / path.name).write_bytes(data)
    done = in_process("import", tmp_path / "shards", "--library", tmp_path / "a.db")
    assert (done.returncode, done.stdout) == (4, "1 of 2 shapes imported: 1 new\n")
    assert "the part 'mesh' is damaged" in done.stderr


def test_an_unfinished_shard_and_other_files_are_left_out(small, tmp_path):
    shutil.copytree(small, tmp_path / "shards")
    (tmp_path / "shards/2-of-3.shard.part").write_bytes(b"")
    (tmp_path / "shards/slurm-17.out").write_text("a log")
    report = tmp_path / "report.csv"
    done = in_process("import", tmp_path / "shards", "--library", tmp_path / "a.db", "--report", report)
    assert (done.returncode, done.stdout) == (4, "2 of 2 shapes imported: 2 new\n")
    assert "2-of-3.shard.part is unfinished: run its `unbend compute` again" in done.stderr
    assert sorted(row["reason"] for row in rows_of(report).values() if row["outcome"] == "left out") == [
        "an unfinished shard", "not a shard",
    ]  # fmt: skip
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty/1-of-1.shard.part").write_bytes(b"")
    refused = in_process("import", tmp_path / "empty", "--library", tmp_path / "a.db")
    assert refused.returncode == 1
    assert f"{tmp_path / 'empty'}: the shards have no results" in refused.stderr


def test_a_service_takes_no_results(small):
    done = in_process("import", small, "--url", "http://127.0.0.1:9")
    failed_with_a_sentence(done, "a service takes no results: it could not check that they belong to the meshes")
    assert "--library" in done.stderr.splitlines()[1]
    done = in_process("import", small, UNBEND_URL="http://127.0.0.1:9")
    failed_with_a_sentence(done, "a service takes no results")


def test_parameters_are_chosen_before_the_import(small, tmp_path):
    done = in_process("import", small, "--library", tmp_path / "a.db", "--samples", 9)
    failed_with_a_sentence(done, "are chosen by `unbend compute`", status=2)
    (tmp_path / "a.ply").write_bytes(small_mesh(0))
    done = in_process("import", tmp_path / "a.ply", "--library", tmp_path / "a.db")
    failed_with_a_sentence(done, "is neither a folder nor a shard", status=2)


def test_a_shard_without_files_is_no_error_but_a_folder_without_meshes_is(small, tmp_path):
    folder = small.parent / "in"
    count = 50
    empty = next(
        number
        for number in range(1, count + 1)
        if not any(ShardNumber(number, count).has(path.relative_to(folder)) for path in folder.iterdir())
    )
    done = succeeded("compute", folder, "--out", tmp_path / "out", "--shard", f"{empty}/{count}", *FAST, run=in_process)
    assert done.stdout == "0 of 0 shapes computed: 0 new\n"
    assert list((tmp_path / "out").iterdir()) == []
    (tmp_path / "none").mkdir()
    done = in_process("compute", tmp_path / "none", "--out", tmp_path / "out", *FAST)
    failed_with_a_sentence(done, "there is no file that ends in")
    done = in_process("compute", folder, "--out", tmp_path / "out", "--shard", "0/3", *FAST)
    failed_with_a_sentence(done, "a shard is I/N")


def test_shards_within_the_folder_are_not_part_of_it(three):
    for new in ("3 new", "0 new, 3 unchanged"):
        done = succeeded("compute", three, "--out", three / "deep/shards", *FAST, run=in_process)
        assert done.stdout == f"3 of 3 shapes computed: {new}\n"
        assert "left out" not in done.stderr


# Processes


@pytest.fixture(scope="module")
def many(tmp_path_factory) -> Path:
    """A folder of many meshes, each of which takes a moment."""
    made = tmp_path_factory.mktemp("many")
    for number in range(MANY):
        (made / f"{number:02d}.ply").write_bytes(ply(torus(minor=0.2 + 0.001 * number, columns=60, rows=40)))
    return made


class Command:
    """A computation that runs."""

    def __init__(self, folder: Path, output: Path) -> None:
        self.output = output
        command = [sys.executable, "-m", "unbend", "compute", folder, "--out", output, *FAST]
        self.process = subprocess.Popen(
            [*map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=without_settings(),
            start_new_session=True,
        )  # fmt: skip

    def until_written(self, more: int) -> None:
        """Wait until so many bytes are written more than now."""
        began, end = time.monotonic(), _written(self.output) + more
        while _written(self.output) < end:
            assert time.monotonic() - began < PATIENCE
            if self.process.poll() is not None:
                return
            time.sleep(0.001)


def _written(output: Path) -> int:
    return sum(path.stat().st_size for path in output.glob("*.part")) if output.is_dir() else 0


def test_a_killed_computation_continues_and_gives_the_same(many, tmp_path):
    random = np.random.default_rng(3)
    output = tmp_path / "shards"
    sizes = []
    for _ in range(3):
        command = Command(many, output)
        command.until_written(int(random.integers(1, 300_000)))
        time.sleep(float(random.uniform(0, 0.05)))
        workers = workers_of(command.process.pid)
        command.process.kill()
        command.process.communicate(timeout=PATIENCE)
        sizes.append(_written(output))
        began = time.monotonic()
        while any(map(is_running, workers)):
            assert time.monotonic() - began < PATIENCE
            time.sleep(0.02)
    assert sizes == sorted(sizes)  # no run loses what another has written
    assert [path.name for path in output.iterdir()] == ["1-of-1.shard.part"]
    done = succeeded("compute", many, "--out", output, *FAST, run=in_process)
    kept = int(done.stdout.partition("new, ")[2].partition(" unchanged")[0] or 0)
    assert 0 < kept < MANY
    assert done.stdout == f"{MANY} of {MANY} shapes computed: {MANY - kept} new, {kept} unchanged\n"
    succeeded("compute", many, "--out", tmp_path / "once", *FAST, run=in_process)
    shapes, _, errors = accepted(output.iterdir())
    assert not errors
    assert shapes == accepted((tmp_path / "once").iterdir())[0]
    assert len(shapes) == MANY


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_ended_computation_finishes_its_shard(many, tmp_path, number):
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell lets commands in the background ignore it
    command = Command(many, tmp_path)
    command.until_written(100_000)
    os.killpg(command.process.pid, number)
    out, errors = command.process.communicate(timeout=PATIENCE)
    assert (command.process.returncode, out) == (130, "")
    assert errors.splitlines()[-1].startswith("unbend: interrupted; what is written stays, and the same command")
    assert [path.name for path in tmp_path.iterdir()] == ["1-of-1.0000.shard"]
    shapes, files, faults = accepted(tmp_path.iterdir())
    assert 0 < len(shapes) == len(files) < MANY
    assert not faults


def test_a_second_process_of_a_shard_is_refused(many, tmp_path):
    command = Command(many, tmp_path)
    command.until_written(1)
    done = in_process("compute", many, "--out", tmp_path, *FAST)
    failed_with_a_sentence(done, "another process computes shard 1/1")
    command.process.terminate()
    command.process.communicate(timeout=PATIENCE)
