"""Commands on a library and on a service: list, show, label, remove, jobs, and what they refuse."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from types import SimpleNamespace

import pytest

from tests.support.commands import failed_with_a_sentence, in_process, on_terminal, succeeded
from tests.support.server import ENDLESS, SAMPLES, Server, endless_mesh, ply, without_settings
from unbend import Client, Library, Parameters, read_mesh
from unbend.cli.places import whole_id
from unbend.errors import ParameterError
from unbend.library.jobs import ANONYMOUS, QueueLimits
from unbend.library.requests import ShapeRequest, Upload
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.shapes import torus
from unbend.render.picture import render_picture
from unbend.render.request import PictureRequest

NAMES = ("first", "second", "third")


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A server for this module alone: its messages name the parameters that most of its shapes have."""
    with Server(tmp_path_factory.mktemp("places")) as running:
        yield running


@pytest.fixture(params=["library", "url"])
def place(request, tmp_path, server) -> tuple[list[object], list[str]]:
    """A library or a service: its options, and the ids of three shapes of the class "place", or "places"."""
    meshes = [ply(torus(minor=0.61 + 0.01 * number, columns=10, rows=6)) for number in range(3)]
    labels = ["place", "places", "place"]
    path = tmp_path / "library.db"
    if request.param == "library":
        with Library(str(path)) as library:
            shapes = [
                library.add(mesh, name=name, label=label, parameters=SAMPLES).id
                for mesh, name, label in zip(meshes, NAMES, labels, strict=True)
            ]
        return ["--library", path], shapes
    with Client(server.url) as client:
        ids = []
        for mesh, name, label in zip(meshes, NAMES, labels, strict=True):  # one after the other, for their order
            job = client.submit(mesh, name=name, label=label, parameters=SAMPLES, if_known="update")
            ids.append(job.result(120).id)
        return ["--url", server.url], ids


def run_json(*arguments: object) -> dict:
    return json.loads(succeeded(*arguments, "--json", run=in_process).stdout)


def test_shapes_are_listed_by_class_with_their_whole_records(place, server):
    where, ids = place
    lines = succeeded("list", *where, "--label", "place", run=in_process).stdout.splitlines()
    assert lines[0].split() == ["id", "name", "class"]
    assert [line.split() for line in lines[1:]] == [[ids[0], "first", "place"], [ids[2], "third", "place"]]
    (record,) = run_json("list", *where, "--label", "place", "--limit", 1)["shapes"]
    assert (record["id"], record["name"], record["parameters"]) == (ids[0], "first", Parameters(samples=40).as_dict())
    with Client(server.url) as client:
        client.submit(ply(torus(columns=10, rows=6)), parameters=SAMPLES).result(120)
        (sent,) = client.request("GET", "/v1/shapes", params={"limit": 1}).json()["items"]
        assert set(record) == set(sent)
    assert record["created_at"].endswith("+00:00")
    assert "no shapes" in succeeded("list", *where, "--label", "nobody", run=in_process).stdout


def test_a_shape_is_printed_and_drawn_by_its_id(place, tmp_path):
    where, ids = place
    record = run_json("show", ids[1], *where)
    assert (record["name"], record["label"]) == ("second", "places")
    lines = succeeded("show", ids[1], *where, run=in_process).stdout.splitlines()
    assert lines[0].split() == ["id", ids[1]]
    assert any(line.split() == ["label", "places"] for line in lines)
    picture = tmp_path / "x.png"
    done = succeeded("show", ids[1], *where, "-o", picture, run=in_process)
    assert (done.stdout, done.stderr) == ("", f"{picture}: 512 x 512 pixels\n")
    mesh = ply(torus(minor=0.61 + 0.01, columns=10, rows=6))
    assert picture.read_bytes() == render_picture(PictureRequest(), read_mesh(mesh))
    failed_with_a_sentence(in_process("show", "0" * 32, *where), "0" * 32)
    assert "`unbend list`" in in_process("show", "0" * 32, *where).stderr


def test_the_first_digits_of_an_id_suffice(place, tmp_path, monkeypatch):
    where, ids = place
    assert run_json("show", ids[1][:6], *where)["id"] == ids[1]
    assert ids[1] in succeeded("label", ids[1][:31], "ring", *where, run=in_process).stdout
    succeeded("show", ids[1][:8], *where, "-o", tmp_path / "x.png", run=in_process)
    for command in (["show"], ["label"]):
        rest = ["ring"] if command == ["label"] else []
        failed_with_a_sentence(in_process(*command, "000000", *rest, *where), "begins with 000000")
        assert in_process(*command, ids[1][:5], *rest, *where).returncode != 0
    monkeypatch.chdir(tmp_path)
    (tmp_path / ids[1][:6]).write_bytes(b"")
    failed_with_a_sentence(in_process("show", ids[1][:6], *where), "needs -o", status=2)  # a file comes first


def test_an_ambiguous_beginning_of_an_id_names_the_shapes():
    shapes = [SimpleNamespace(id=f"abcdef{digit}".ljust(32, "0"), name=f"shape {digit}") for digit in "012"]
    some = SimpleNamespace(iter_shapes=lambda: iter(shapes))
    assert whole_id(some, "abcdef1") == shapes[1].id
    with pytest.raises(ParameterError, match=r"3 shapes have an id that begins with abcdef, such as .*\(shape 0\)"):
        whole_id(some, "abcdef")


def test_a_signature_is_drawn_with_the_parameters_of_the_shape(place, tmp_path):
    where, ids = place
    figures = run_json("show", ids[0], *where, "-o", tmp_path / "x.png", "--subject", "both")
    assert figures["stress"] == pytest.approx(run_json("show", ids[0], *where)["stress"], rel=1e-4)


def test_a_class_is_set_and_removed(place):
    where, ids = place
    assert "has the class ring" in succeeded("label", ids[0], "ring", *where, run=in_process).stdout
    assert run_json("show", ids[0], *where)["label"] == "ring"
    assert run_json("label", ids[0], "--none", *where)["label"] is None
    assert run_json("show", ids[0], *where)["label"] is None
    for arguments in ([ids[0]], [ids[0], "ring", "--none"]):
        failed_with_a_sentence(in_process("label", *arguments, *where), "either a CLASS or --none", status=2)
    assert succeeded("-q", "label", ids[0], "place", *where, run=in_process).stdout == ""


def test_shapes_are_removed_and_missing_ones_are_named(place):
    where, ids = place
    done = in_process("remove", ids[0], "0" * 32, ids[2], *where)
    assert (done.returncode, done.stdout) == (4, "2 of 3 shapes removed\n")
    assert len(done.stderr.splitlines()) == 2
    assert "0" * 32 in done.stderr.splitlines()[0]
    assert "`unbend list`" in done.stderr.splitlines()[1]
    left = run_json("list", *where)["shapes"]
    assert ids[1] in [shape["id"] for shape in left]
    assert not {ids[0], ids[2]} & {shape["id"] for shape in left}
    assert run_json("remove", ids[1], *where) == {"removed": [ids[1]]}


def test_jobs_of_a_service_are_listed_and_cancelled(server):
    with Client(server.url) as client:
        job = client.submit(endless_mesh(), parameters=ENDLESS)
        listed = run_json("jobs", "--url", server.url, "--limit", 1)["jobs"]
        assert [item["id"] for item in listed] == [job.id]
        (cancelled,) = run_json("jobs", "--url", server.url, "--cancel", job.id)["jobs"]
        assert cancelled["state"] == "cancelled"
        assert job.status().state == "cancelled"
    line = succeeded("jobs", "--url", server.url, "--limit", 1, "--state", "cancelled", run=in_process).stdout
    assert line.splitlines()[1].split()[:3] == [job.id, "shape", "cancelled"]
    missing = in_process("jobs", "--url", server.url, "--cancel", "0" * 32)
    failed_with_a_sentence(missing, "0" * 32)
    assert "`unbend jobs`" in missing.stderr


def test_jobs_of_a_library_are_listed_and_cancelled(tmp_path, server):
    path = tmp_path / "a.db"
    with Library(str(path)) as library:
        assert "no jobs" in succeeded("jobs", "--library", path, run=in_process).stdout
        upload = Upload(ply(torus(columns=10, rows=6)), "ply", Parameters(), MeshPolicy())
        request = ShapeRequest.of("ring", {}, "keep")
        job = library.jobs.submit_shape(upload, request, ANONYMOUS, QueueLimits(queued=9)).result().job
    (record,) = run_json("jobs", "--library", path)["jobs"]
    assert (record["id"], record["state"], record["position"]) == (job.id, "queued", 0)
    with Client(server.url) as client:
        client.submit(ply(torus(columns=10, rows=6)), parameters=SAMPLES).wait(120)
        listed = run_json("jobs", "--url", server.url)["jobs"]
        assert not listed or set(record) == set(listed[0])
    assert run_json("jobs", "--library", path, "--cancel", job.id)["jobs"][0]["state"] == "cancelled"
    assert run_json("jobs", "--library", path, "--state", "queued")["jobs"] == []


def test_a_library_and_a_service_exclude_each_other(tmp_path):
    here, there = ["--library", tmp_path / "a.db"], ["--url", "http://127.0.0.1:9"]
    commands = (["list"], ["remove", "0" * 32], ["import", tmp_path], ["evaluate"], ["jobs"])
    for command in commands:
        for both in (here + there, there + here):
            failed_with_a_sentence(in_process(*command, *both), "--library and --url exclude", status=2)
    both = {"UNBEND_LIBRARY": "a.db", "UNBEND_URL": "http://127.0.0.1:9"}
    failed_with_a_sentence(in_process("list", **both), "UNBEND_LIBRARY and UNBEND_URL exclude", status=2)
    failed_with_a_sentence(in_process("list", *here, **both), "no library at")  # the option wins
    failed_with_a_sentence(in_process("list", *there, **both), "could not be reached")
    failed_with_a_sentence(in_process("list", UNBEND_URL="http://127.0.0.1:9"), "could not be reached")
    failed_with_a_sentence(in_process("list", *here, UNBEND_URL="http://127.0.0.1:9"), "no library at")


@pytest.mark.parametrize(
    "command",
    [
        "list", "show {id}", "show {id} -o {new}/x.png", "label {id} cat", "remove {id}", "jobs", "jobs --cancel {id}",
        "query {mesh}", "evaluate", "export {new}/out", "backup {new}/copy.db", "complete", "keys list",
        "keys revoke {id}",
    ],
)  # fmt: skip
def test_a_library_that_does_not_exist_is_not_made(tmp_path, command):
    mesh = tmp_path / "ring.ply"
    mesh.write_bytes(ply(torus(columns=10, rows=6)))
    words = shlex.split(command.format(id="0" * 32, new=tmp_path, mesh=mesh))
    done = in_process(*words, "--library", tmp_path / "nowhere.db")
    failed_with_a_sentence(done, "there is no library at", "nowhere.db")
    assert "`unbend import`" in done.stderr
    assert list(tmp_path.iterdir()) == [mesh]


def test_a_query_that_compares_with_nothing_says_why(place, tmp_path):
    where, _ = place
    mesh = tmp_path / "ring.ply"
    mesh.write_bytes(ply(torus(columns=10, rows=6)))
    asked = ["query", mesh, *where, "--samples", 23, "--seed", 5]
    for options in ([], ["--json"]):
        done = in_process(*asked, *options)
        failed_with_a_sentence(done, "no shape compares with --samples 23", "--samples 40")
        assert "import its shapes with these" in done.stderr
    with Library(str(tmp_path / "empty.db")):
        pass
    done = in_process("query", mesh, "--library", tmp_path / "empty.db")
    failed_with_a_sentence(done, "the library has no shapes")
    assert "`unbend import`" in done.stderr


def test_an_evaluation_of_nothing_says_why(place, tmp_path):
    where, _ = place
    done = in_process("evaluate", *where, "--samples", 23, "--seed", 5)
    failed_with_a_sentence(done, "no shape compares with --samples 23", "--samples 40")
    alone = ["--library", tmp_path / "alone.db"]
    mesh = tmp_path / "ring.ply"
    mesh.write_bytes(ply(torus(columns=10, rows=6)))
    with Library(str(tmp_path / "alone.db")) as library:
        shape_id = library.add(mesh, parameters=SAMPLES).id
    asked = ["evaluate", *alone, "--samples", 40]
    failed_with_a_sentence(in_process(*asked), "no shape has a class")
    assert "--label-from folder" in in_process(*asked).stderr
    succeeded("label", shape_id, "ring", *alone, run=in_process)
    failed_with_a_sentence(in_process(*asked), "no class has two members")


def test_a_query_says_what_it_cannot_tell(tmp_path):
    mesh = tmp_path / "ring.ply"
    mesh.write_bytes(ply(torus(minor=0.61, columns=10, rows=6)))
    where = ["--library", tmp_path / "a.db"]
    asked = ["query", mesh, *where, "--samples", 40]
    with Library(str(tmp_path / "a.db")) as library:
        ids = [
            library.add(ply(torus(minor=0.6 + 0.02 * number, columns=10, rows=6)), parameters=SAMPLES).id
            for number in range(8)
        ]
        first, second = succeeded(*asked, run=in_process).stdout.split("\n\n")
        assert first.startswith("none of the compared shapes has a class")
        assert "--label-from folder" in first
        assert set(ids) <= set(second.split())  # whole, because a pipe cuts nothing off
        for number, shape_id in enumerate(ids):
            library.change(shape_id, label=f"kind {number}\n")
    classes = succeeded(*asked, run=in_process).stdout.split("\n\n")[0].splitlines()
    assert len(classes) == 1 + 8 + 1
    words = r"kind [01]\\n has one shape to compare with: unbend cannot tell whether the mesh belongs to it"
    assert re.fullmatch(words, classes[-1])
    status, shown = on_terminal([sys.executable, "-m", "unbend", *asked], "stdout")
    assert status == 0
    assert "and 3 more classes" in shown
    assert ids[0][:8] in shown
    assert ids[0] not in shown


def test_a_query_names_the_measure_of_each_distance(place, tmp_path):
    where, _ = place
    mesh = tmp_path / "ring.ply"
    mesh.write_bytes(ply(torus(columns=10, rows=6)))
    asked = ["query", mesh, *where, "--samples", 40, "--measure"]
    headings = [part.splitlines()[0] for part in succeeded(*asked, "reeb", run=in_process).stdout.split("\n\n")]
    assert "distance (spectrum)" in headings[0]
    assert "distance (reeb)" in headings[1]
    assert "distance (" not in succeeded(*asked, "moments", run=in_process).stdout


def test_a_list_shows_samples_that_differ(tmp_path):
    where = ["--library", tmp_path / "a.db"]
    with Library(str(tmp_path / "a.db")) as library:
        library.add(ply(torus(columns=10, rows=6)), parameters=SAMPLES)
        assert "samples" not in succeeded("list", *where, run=in_process).stdout
        library.add(ply(torus(columns=10, rows=6)), parameters={"samples": 30})
    lines = succeeded("list", *where, run=in_process).stdout.splitlines()
    assert lines[0].split() == ["id", "name", "class", "samples"]
    assert [line.split()[-1] for line in lines[1:]] == ["40", "30"]


def test_an_address_without_http_is_refused_with_the_right_one():
    done = in_process("list", "--url", "127.0.0.1:8413")
    failed_with_a_sentence(done, "begins with http://")
    assert "Try http://127.0.0.1:8413" in done.stderr


def test_an_evaluation_reads_a_library_or_a_service(place, server):
    where, _ = place
    asked = ["evaluate", *where, "--samples", 40, "--measure", "moments"]
    if "--url" in where:
        with Client(server.url) as client:
            expected = client.evaluation(measure="moments", parameters=SAMPLES).as_dict()
    else:
        with Library(str(where[1])) as library:
            expected = library.evaluation("moments", parameters=Parameters(samples=40)).as_dict()
    found = run_json(*asked, "--per-class")["moments"]
    assert {name: found[name] for name in expected} == expected
    assert run_json(*asked)["moments"] == {name: found[name] for name in ("nn", "ft", "st", "e", "dcg", "map")}
    sentence, empty, _, figures = succeeded(*asked, run=in_process).stdout.splitlines()
    right, queries = map(int, re.findall(r"\d+", sentence)[:2])
    assert sentence.startswith(f"moments: {right} of {queries} nearest shapes have the class of the query")
    assert right / queries == pytest.approx(found["nn"])
    assert (empty, figures.split()[:2]) == ("", ["moments", f"{found['nn']:.3f}"])


def test_an_evaluation_takes_classes_from_folders(tmp_path):
    rows = ["path,class"]
    for number in range(4):
        path = tmp_path / "in" / ("thin" if number < 2 else "thick") / f"{number}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(ply(torus(minor=0.1 + 0.01 * number + 0.2 * (number > 1), columns=10, rows=6)))
        rows.append(f"{path.relative_to(tmp_path / 'in')},{path.parent.name}")
    (tmp_path / "labels.csv").write_text("\n".join(rows))
    asked = ["evaluate", tmp_path / "in", "--measure", "moments", "--samples", 20, "--per-class"]
    by_folder = run_json(*asked, "--label-from", "folder")
    by_table = run_json(*asked, "--labels", tmp_path / "labels.csv")
    assert by_folder["moments"]["queries"] == 4
    assert by_folder["moments"]["nn"] == by_table["moments"]["nn"]
    assert {row["label"] for row in by_folder["moments"]["classes"]} == {"thin", "thick"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--label-from folder", "--label-from needs DIR"),
        ("--html x.html", "--html needs DIR"),
        ("--separation", "--separation needs DIR"),
        ("--smooth 3", "--smooth needs DIR"),
        ("{folder} --library a.db --label-from folder", "DIR and --library exclude"),
        ("{folder}", "either --labels or --label-from"),
    ],
)
def test_options_of_an_evaluation_that_do_not_go_together_are_refused(tmp_path, options, words):
    failed_with_a_sentence(in_process("evaluate", *options.format(folder=tmp_path).split()), words, status=2)


def test_a_reader_that_has_read_enough_ends_a_command_silently(tmp_path):
    with Library(str(tmp_path / "a.db")):
        pass
    command = [sys.executable, "-m", "unbend", "list", "--library", str(tmp_path / "a.db")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=without_settings()) as process:
        assert process.stdout
        process.stdout.close()  # long before the command prints
        assert process.stderr
        assert process.stderr.read() == b""
