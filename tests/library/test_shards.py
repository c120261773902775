"""Shards: their format, interrupted writers, damage at any byte, and values that a stranger has chosen."""

from __future__ import annotations

import hashlib
import io
import json
import re
import resource
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.server import small_mesh
from tests.support.shards import QUICK, accepted, edited, entries_of, forged, write_shard
from unbend import MeshPolicy, Parameters
from unbend.errors import ParameterError, ResultsError
from unbend.library.computed import LENGTHS, check_computed, compute_file
from unbend.library.requests import UploadKey
from unbend.library.shards.entries import encode, read_entries
from unbend.library.shards.index import ShardIndex
from unbend.library.shards.numbering import ShardNumber
from unbend.library.shards.records import FILE, FileRecord
from unbend.library.shards.writer import ShardWriter
from unbend.mesh.shapes import sheet
from unbend.mesh.write import write_mesh

FLIPS = 400
CUTS = 120
SHARD = ShardNumber(2, 3)


@pytest.fixture(scope="module")
def entries() -> list[list[bytes]]:
    """The entries of three meshes, of which the first has local signatures."""
    return [
        entry
        for number in range(3)
        for entry in entries_of(small_mesh(number), f"deep/{number}.ply", parts=number == 0)
    ]


@pytest.fixture(scope="module")
def shard(entries, tmp_path_factory) -> Path:
    return write_shard(tmp_path_factory.mktemp("shards"), entries, SHARD)


# Division


@given(st.lists(st.text(st.characters(exclude_characters="\0"), min_size=1), unique=True), st.integers(1, 40))
def test_every_file_belongs_to_one_shard_which_other_files_do_not_change(names, count):
    shards = [ShardNumber(number, count) for number in range(1, count + 1)]
    for name in names:
        path = PurePosixPath("folder") / name.encode("utf-8", "surrogatepass").decode("utf-8", "surrogateescape")
        assert sum(shard.has(path) for shard in shards) == 1


def test_shards_have_similar_sizes():
    paths = [PurePosixPath(f"scans/{number:05}.ply") for number in range(8000)]
    sizes = [sum(ShardNumber(number, 8).has(path) for path in paths) for number in range(1, 9)]
    assert sum(sizes) == 8000
    assert 850 <= min(sizes) <= max(sizes) <= 1150  # 1000 on average, with a standard deviation of 30


@pytest.mark.parametrize("text", ["", "3", "0/4", "5/4", "1/0", "-1/4", "1/4 ", "1/200000", "a/b", "1/" + "9" * 5000])
def test_a_malformed_number_of_a_shard_is_an_error(text):
    with pytest.raises(ParameterError, match="a shard is I/N"):
        ShardNumber.parse(text)


# Writers


def test_a_shard_has_what_was_written(entries, shard):
    assert shard.name == "2-of-3.0000.shard"
    shapes, files, errors = accepted([shard])
    assert (len(shapes), len(files), errors) == (3, 3, [])
    expected = compute_file(small_mesh(1), QUICK, parts=False)
    assert shapes[expected.key][-1] == small_mesh(1)
    assert shapes[expected.key][1] == expected.area
    begin = json.loads(shard.read_bytes().splitlines()[0][17:])
    assert (begin["kind"], begin["format"], begin["shard"]) == ("shard", 1, "2/3")


def test_a_full_file_is_finished_and_another_begun(entries, tmp_path):
    with ShardWriter(tmp_path, SHARD, {}, full_bytes=1) as writer:
        for entry in entries:
            writer.append(entry)
            writer.flush()
    paths = sorted(tmp_path.iterdir())
    assert [path.name for path in paths] == [f"2-of-3.{number:04}.shard" for number in range(len(entries))]
    shapes, files, errors = accepted(paths)
    assert (len(shapes), len(files), errors) == (3, 3, [])


def test_a_writer_without_entries_leaves_no_file(tmp_path):
    with ShardWriter(tmp_path, SHARD, {}):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_second_writer_of_a_shard_is_refused(entries, tmp_path):
    with ShardWriter(tmp_path, SHARD, {}) as writer:
        writer.append(entries[0])
        with pytest.raises(ResultsError, match="another process computes shard 2/3"):
            ShardWriter(tmp_path, SHARD, {})
        with ShardWriter(tmp_path, ShardNumber(1, 3), {}) as other:
            other.append(entries[2])
    shapes, _, errors = accepted(tmp_path.glob("*.shard"))
    assert (len(shapes), errors) == (2, [])


def test_a_writer_continues_wherever_another_was_killed(entries, tmp_path):
    with ShardWriter(tmp_path / "whole", SHARD, {}) as writer:
        for entry in entries:
            writer.append(entry)
        (unfinished,) = (tmp_path / "whole").iterdir()
        end = unfinished.stat().st_size
    (finished,) = (tmp_path / "whole").iterdir()
    whole, expected = finished.read_bytes(), accepted([finished])  # a file gets its end before its final name
    random = np.random.default_rng(0)
    kept = []
    for number in range(CUTS):
        folder = tmp_path / str(number)
        folder.mkdir()
        cut = (0, end - 1, end, len(whole), int(random.integers(len(whole))))[min(number, 4)]
        garbage = random.bytes(int(random.integers(200)))  # a power failure may leave anything that was not flushed
        flushed = bytearray(whole[:cut])
        if number % 3 == 2 and number > 3:
            lost = int(random.integers(len(flushed)))
            flushed[lost : lost + 64] = bytes(len(flushed[lost : lost + 64]))
        (folder / unfinished.name).write_bytes(flushed + garbage)
        with ShardWriter(folder, SHARD, {}) as writer:
            count = len(list(writer.earlier()))
            for entry in entries[count:]:
                writer.append(entry)
        kept.append(count)
        assert [path.name for path in folder.iterdir()] == ["2-of-3.0000.shard"]
        assert accepted(folder.iterdir()) == expected
    assert {0, len(entries) - 1, len(entries)} <= set(kept)


def test_an_error_while_writing_leaves_what_was_complete(entries, tmp_path):
    def interrupted() -> None:
        with ShardWriter(tmp_path, SHARD, {}) as writer:
            writer.append(entries[0])
            writer.append(iter([entries[2][0], 0]))  # not bytes

    with pytest.raises(TypeError):
        interrupted()
    shapes, _, errors = accepted(tmp_path.iterdir())
    assert (len(shapes), errors) == (1, [])


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Let no file of this process become larger, as if the disk were full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_is_an_error_with_the_file_and_the_next_writer_continues(entries, tmp_path):
    place = tmp_path / f"{SHARD.stem}.shard.part"
    size = sum(map(len, entries[0])) + sum(map(len, entries[1])) + 1000
    with files_of_at_most(size), pytest.raises(OSError, match="File too large") as caught:
        write_shard(tmp_path, entries, SHARD)
    assert caught.value.filename == str(place)
    shapes, _, errors = accepted(tmp_path.iterdir())
    assert (len(shapes), errors) == (1, [])  # there was space for the end
    with ShardWriter(tmp_path, SHARD, {}) as writer:
        for entry in entries[2:]:
            writer.append(entry)
    shapes, _, errors = accepted(tmp_path.iterdir())
    assert (len(shapes), errors) == (3, [])


# Damage


def assert_refused(path: Path, clean) -> None:
    """Check that a damaged shard is reported with its place, and that whatever is accepted is right."""
    shapes, files, errors = accepted([path])
    assert errors
    for error in errors:
        assert re.match(rf"{re.escape(str(path))}, byte \d+: ", str(error))
        assert f"Remove {path}" in error.advice
    assert shapes.items() <= clean[0].items()
    assert files <= clean[1]


def test_damage_at_any_byte_is_an_error_that_names_the_place(shard, tmp_path):
    clean, data = accepted([shard]), shard.read_bytes()
    random = np.random.default_rng(1)
    places = [0, 15, 16, 17, len(data) - 1, *random.integers(len(data), size=FLIPS).tolist()]
    # Few bytes are in lines or at the ends of entries, and most in parts.
    lines = [place for entry in read_entries(shard) for place in (entry.offset + 30, entry.end - 1)]
    for place in places + lines:
        flipped = bytearray(data)
        flipped[place] ^= int(random.integers(1, 256))
        path = tmp_path / "1-of-1.0000.shard"
        path.write_bytes(flipped)
        assert_refused(path, clean)


def test_a_shard_that_ends_early_or_late_is_an_error(shard, tmp_path):
    clean, data = accepted([shard]), shard.read_bytes()
    ends = [entry.end for entry in read_entries(shard)]
    random = np.random.default_rng(2)
    path = tmp_path / "1-of-1.0000.shard"
    for cut in [0, 1, *ends, len(data) - 1, *random.integers(len(data), size=50).tolist()]:
        path.write_bytes(data[:cut])
        assert_refused(path, clean)
    for more in (b"\n", b"x" * 100, data):
        path.write_bytes(data + more)
        assert_refused(path, clean)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.just("shard"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["mesh", "a"]), inner),
    max_leaves=5,
)


@settings(max_examples=300)
@given(
    st.binary(max_size=100)
    | st.dictionaries(st.sampled_from(["kind", "parts", "format"]), JSON).map(lambda value: json.dumps(value).encode())
)
def test_any_bytes_are_no_shard(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "1-of-1.0000.shard"
    for text in (data, hashlib.sha256(data).hexdigest()[:16].encode() + b" " + data + b"\n"):
        path.write_bytes(text)
        with ShardIndex() as index, pytest.raises(ResultsError):
            index.add_shard(path)


def test_a_file_that_is_missing_is_an_error(tmp_path):
    with ShardIndex() as index, pytest.raises(ResultsError, match="cannot be read: No such file"):
        index.add_shard(tmp_path / "1-of-1.0000.shard")


def test_another_format_is_refused(tmp_path):
    path = tmp_path / "1-of-1.0000.shard"
    path.write_bytes(b"".join([*encode("shard", {"format": 2}, {}), *encode("end", {"entries": 0}, {})]))
    with pytest.raises(ResultsError, match="has the format 2, and this version of unbend reads 1"):
        list(read_entries(path))
    path.write_bytes(b"".join([*encode("file", {}, {}), *encode("end", {"entries": 0}, {})]))
    with pytest.raises(ResultsError, match="is no shard"):
        list(read_entries(path))


# Strangers


def of_signature(about=None, **arrays):
    return lambda _, parts: parts.update(signature=edited(parts["signature"], about, **arrays))


def of_local(about=None, **arrays):
    return lambda _, parts: parts.update(local=edited(parts["local"], about, **arrays))


def of_content(**values):
    return lambda content, _: content.update(values)


def of_report(**values):
    return lambda content, _: content["report"].update(values)


def of_vector(name, *values):
    return lambda _, parts: parts.update({f"descriptor.{name}": np.array(values, "<f8").tobytes()})


def without(name):
    return lambda _, parts: parts.pop(name)


NAN = float("nan")
POINTS = np.zeros((8, 3))
FORGED = {
    "another version": (of_content(version="4"), "version '4' of the algorithm, and this unbend has version '5'"),
    "a version that is none": (of_content(version=5), "malformed"),
    "a hash that is none": (of_content(sha256="x"), "malformed hash"),
    "another mesh": (lambda _, parts: parts.update(mesh=b"x"), "malformed"),
    "no mesh": (without("mesh"), "malformed"),
    "no signature": (without("signature"), "malformed"),
    "parameters that are none": (of_content(parameters='{"samples": 1}'), "samples must be"),
    "parameters in another form": (of_content(parameters='{"samples": 8}'), "in another form"),
    "another policy": (of_content(policy='{"smooth": 1000}'), "smooth"),
    "no area": (of_content(area=0), "an area"),
    "an area of text": (of_content(area="1"), "an area"),
    "an infinite area": (of_content(area=float("inf")), "an area"),
    "another stress": (of_content(stress=0.5), "stress"),
    "another boundary": (of_content(boundary=9.0), "boundary"),
    "another dimension": (of_content(dimension=9), "dimension"),
    "other warnings": (of_content(warnings=["trust me"]), "warnings"),
    "warnings that are a number": (of_content(warnings=3), "report|warnings"),
    "no report": (of_content(report=None), "report"),
    "a report of a list": (of_content(report=[]), "report"),
    "a report with more": (of_report(more=1), "report with other fields"),
    "a report of another type": (of_report(file_type="exe"), "unknown format"),
    "a report with a negative count": (of_report(vertices=-1), "vertices"),
    "a report with a text for a number": (of_report(roughness="0"), "roughness"),
    "a report with notes of numbers": (of_report(notes=[1]), "notes"),
    "too few vertices": (of_report(vertices=3), "samples that are no vertices"),
    "a payload that is no archive": (lambda _, parts: parts.update(signature=b"PK"), "cannot be read"),
    "a payload with another array": (of_signature(more=POINTS), "archive of other arrays"),
    "a payload with a missing array": (of_signature(faces=None), "archive of other arrays"),
    "a pickled array": (of_signature(points=np.array([{}])), "cannot be read"),
    "points that are text": (of_signature(points=POINTS.astype("U8")), "another type"),
    "points of single precision": (of_signature(points=POINTS.astype("f4")), "another type"),
    "points that are not finite": (of_signature(points=POINTS * NAN), "not finite"),
    "a line of points": (of_signature(points=POINTS[0]), "wrong shapes"),
    "too many points": (of_signature(points=np.zeros((9, 3))), "wrong lengths"),
    "no points": (
        of_signature(points=POINTS[:0], samples=np.zeros(0, "i8"), weights=np.zeros(0), faces=np.zeros((0, 3), "i4")),
        "number of samples",
    ),
    "too many dimensions": (of_signature(points=np.zeros((8, 4))), "number of dimensions"),
    "faces with missing corners": (of_signature(faces=np.full((1, 3), 8, "i4")), "missing corners"),
    "faces with negative corners": (of_signature(faces=np.full((1, 3), -1, "i4")), "missing corners"),
    "faces of four corners": (of_signature(faces=np.zeros((1, 4), "i4")), "wrong shapes"),
    "samples that are no vertices": (of_signature(samples=np.full(8, 60)), "no vertices"),
    "weights that are no shares": (of_signature(weights=np.full(8, 1.0)), "no shares"),
    "negative weights": (of_signature(weights=np.array([-1.0, 2, 0, 0, 0, 0, 0, 0])), "no shares"),
    "a signature of other parameters": (of_signature({"parameters": {"samples": 300}}), "other parameters"),
    "a signature of another version": (of_signature({"version": "4"}), "another version"),
    "a negative scale": (of_signature({"scale": -1.0}), "a scale"),
    "a stress that is no number": (of_signature({"stress": NAN}), "stress"),
    "an asymmetry of text": (of_signature({"asymmetry": "0"}), "asymmetry"),
    "a further value": (of_signature({"more": 1}), "further values"),
    "a missing descriptor": (without("descriptor.spectrum"), "other descriptors"),
    "a further descriptor": (of_vector("volume", 1.0), "other descriptors"),
    "a descriptor of a wrong length": (of_vector("spectrum", *[0.0] * 119), "wrong length"),
    "a descriptor that is not finite": (of_vector("moments", *[NAN] * 14), "not finite"),
    "a descriptor cut off": (lambda _, parts: parts.update({"descriptor.moments": b"123"}), "cannot be read"),
    "a dimension of 99": (of_vector("dimension", 99, *[0.0] * 6), "dimension"),
    "a graph of nothing": (of_vector("reeb"), "graph"),
    "a graph of many parts": (of_vector("reeb", 1e300, 0), "graph"),
    "a graph of half a part": (of_vector("reeb", 0.5, 0, 0, 0), "graph"),
    "a graph in no interval": (of_vector("reeb", 1, 0, 99, 1, 0, 1), "graph"),
    "a graph in half an interval": (of_vector("reeb", 1, 0, 0.5, 1, 0, 1), "graph"),
    "a graph with an edge to nothing": (of_vector("reeb", 1, 1, 0, 1, 0, 1, 0, 1), "graph"),
    "circles of a wrong shape": (of_local(growth=np.zeros((60, 3), "f4")), "wrong shape"),
    "circles of wrong lengths": (of_local(reach=np.zeros(3, "f4")), "wrong length"),
    "circles that are not finite": (of_local(places=np.full((60, 3), NAN, "f4")), "wrong|finite"),
    "circles of another surface": (of_local({"area": 99.0}), "another surface"),
    "circles of far away": (of_local({"first": 10**9}), "first circle"),
    "circles of another type": (of_local(distances=np.zeros(10)), "another type"),
    "a step that is no number": (of_local({"step": None}), "distances"),
    "local signatures that are no archive": (lambda _, parts: parts.update(local=b"x"), "cannot be read"),
    "an entry of another kind": (of_content(kind="program"), "malformed|unknown kind"),
}
"""Changes of results with right checksums, and what their errors say."""


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_result_is_refused(shard, tmp_path, name):
    change, said = FORGED[name]
    path = forged(shard, tmp_path, change)
    clean = accepted([shard])
    shapes, files, errors = accepted([path])
    (error,) = errors
    assert re.search(said, str(error)), error
    assert re.match(rf"{re.escape(str(path))}, byte \d+: ", str(error))
    assert len(shapes) == 2
    assert shapes.items() <= clean[0].items()
    assert files == clean[1]


def test_a_huge_archive_is_refused_before_it_is_unpacked(shard, tmp_path):
    path = forged(shard, tmp_path, lambda _, parts: parts.update(signature=_bomb(parts["signature"])))
    _, _, (error,) = accepted([path])
    assert "too large" in str(error)


def _bomb(payload: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(payload)) as source, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as target:
        for item in source.infolist():
            more = bytes(2**26) if item.filename == "points.npy" else b""
            target.writestr(item.filename, source.read(item) + more)
    return buffer.getvalue()


def test_an_array_that_claims_to_be_huge_is_refused(shard, tmp_path):
    def claim(_, parts):
        buffer = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(parts["signature"])) as source, zipfile.ZipFile(buffer, "w") as target:
            for item in source.infolist():
                data = source.read(item)
                if item.filename == "points.npy":
                    data = data.replace(b"'shape': (8, 3)", b"'shape': (8888888888888, 3)")
                target.writestr(item.filename, data)
        parts["signature"] = buffer.getvalue()

    _, _, (error,) = accepted([forged(shard, tmp_path, claim)])
    assert "cannot be read" in str(error)


FORGED_FILES = {
    "no path": of_content(path=None),
    "an empty path": of_content(path=""),
    "an endless path": of_content(path="x" * 5000),
    "a class of a number": of_content(label=1),
    "metadata of a list": of_content(metadata=[1]),
    "a time of text": of_content(written="now"),
    "no time": of_content(written=NAN),
    "a missing key": of_content(sha256=None),
}


@pytest.mark.parametrize("name", FORGED_FILES)
def test_a_forged_file_is_refused(shard, tmp_path, name):
    path = forged(shard, tmp_path, FORGED_FILES[name], FILE)
    _, files, (error,) = accepted([path])
    assert "malformed" in str(error)
    assert len(files) == 2


def test_local_signatures_of_another_version_are_left_out(shard, tmp_path):
    path = forged(shard, tmp_path, of_content(local_version="0"))
    shapes, _, errors = accepted([path])
    assert (len(shapes), errors) == (3, [])


@pytest.mark.parametrize(
    "parameters",
    [{}, {"samples": "auto"}, {"dimensions": "auto"}, {"dimensions": 12, "samples": 5, "method": "classical"},
     {"samples": 5000}, {"scaling": "box", "method": "fast"}],
)  # fmt: skip
@pytest.mark.parametrize("policy", [{}, {"max_vertices": 40}, {"smooth": 2, "seams": "keep"}])
def test_what_unbend_computes_passes_the_checks(parameters, policy):
    for mesh in (small_mesh(3), write_mesh(sheet(columns=9, rows=7).vertices, sheet(columns=9, rows=7).faces, "obj")):
        computed = compute_file(mesh, parameters, policy, parts=False)
        check_computed(computed)
        lengths = {name: len(vector) // 8 for name, vector in computed.signature.vectors.items() if name != "reeb"}
        assert lengths == LENGTHS


# The index


def test_the_last_record_of_a_file_is_valid_for_each_choice_of_parameters():
    few, many = (UploadKey.of("a" * 64, Parameters(samples=number), MeshPolicy()) for number in (8, 9))
    with ShardIndex() as index:
        for label, written, key in [("new", 2.0, few), ("old", 1.0, few), ("other", 1.0, many)]:
            index.put(FileRecord("a/b.ply", key, None, label, written=written))
        assert [record.label for record in index.files()] == ["new", "other"]
        assert index.file("a/b.ply", many).label == "other"
        assert index.file("a/c.ply", many) is None


def test_files_have_the_order_in_which_folders_list_them(tmp_path):
    names = ["a.ply", "a/b.ply", "a/ä.ply", "a-b/c.ply", "B.ply", "a\udcff.ply"]
    key = UploadKey.of("a" * 64, Parameters(), MeshPolicy())
    with ShardIndex() as index:
        for name in names:
            index.put(FileRecord(name, key, None, written=1.0))
        found = [record.path for record in index.files()]
    assert found == sorted(names, key=lambda name: PurePosixPath(name).parts)
