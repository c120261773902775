"""A server whose meshes are in an object store: uploads that are on disk only, downloads, and failures of the store."""

from __future__ import annotations

import hashlib
import json
import shutil
import sqlite3
import time
from contextlib import closing
from pathlib import Path

import httpx
import pytest

from tests.support.commands import in_process
from tests.support.server import Server, stored
from unbend import Library, Parameters
from unbend.library.jobs import ANONYMOUS, QueueLimits
from unbend.library.requests import ShapeRequest, Upload

TETRAHEDRON = b"4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 %d\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
FEW = '{"samples": 4}'


def large(height: int) -> bytes:
    """Return an off file of 3 megabytes, most of it a comment: servers spool files above one megabyte to disk."""
    return b"OFF\n" + b"# %s\n" % (b"unbend " * 10) * 42_000 + TETRAHEDRON % height


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("objects")


@pytest.fixture(scope="module")
def objects_server(tmp_path_factory, folder):
    with Server(tmp_path_factory.mktemp("server"), workers=1, objects=f"file://{folder}") as running:
        yield running


@pytest.fixture
def http(objects_server):
    with objects_server.http() as client:
        yield client


def path_of(folder: Path, data: bytes) -> Path:
    sha256 = hashlib.sha256(data).hexdigest()
    return folder / sha256[:2] / sha256[2:]


def test_an_upload_goes_to_the_object_store_and_back(http, folder, objects_server):
    data = large(1)
    shape = stored(http, data, file_name="mesh.off", parameters=FEW)
    assert shape["size"] == len(data)
    assert path_of(folder, data).read_bytes() == data
    with closing(sqlite3.connect(objects_server.library)) as connection:
        assert connection.execute("SELECT count(*) FROM meshes WHERE data IS NOT NULL").fetchone() == (0,)
    address = f"/v1/shapes/{shape['id']}/mesh"
    assert http.get(address).content == data
    part = http.get(address, headers={"Range": "bytes=2000000-2000009"})
    assert (part.status_code, part.content) == (206, data[2000000:2000010])
    assert http.get(address, params={"format": "ply"}).content.startswith(b"ply")
    assert http.delete(f"/v1/shapes/{shape['id']}").status_code == httpx.codes.NO_CONTENT


def test_a_query_by_a_large_file_leaves_nothing(http, folder):
    data = large(2)
    answer = http.post(
        "/v1/queries",
        files={"file": ("mesh.off", data)},
        data={"parameters": FEW},
        headers={"Prefer": "wait=30"},
    )
    assert answer.status_code == httpx.codes.OK, answer.text
    end = time.monotonic() + 10  # deletions follow the response
    while path_of(folder, data).exists():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_large_file_of_an_unknown_format_is_refused(http, folder):
    data = bytes(3 * 2**20)
    answer = http.post("/v1/shapes", files={"file": ("mesh.xyz", data)})
    assert (answer.status_code, answer.json()["code"]) == (415, "mesh_format")
    assert not path_of(folder, data).exists()


def test_failures_of_the_object_store_are_problems(http, folder):
    data = b"OFF\n" + TETRAHEDRON % 3
    shape, path = stored(http, data, file_name="mesh.off", parameters=FEW), path_of(folder, data)
    address = f"/v1/shapes/{shape['id']}/mesh"
    path.write_bytes(data.replace(b"1", b"2"))
    damaged = http.get(address)
    assert (damaged.status_code, damaged.json()["code"]) == (500, "object_damaged")
    assert shape["sha256"] in damaged.json()["detail"]
    path.unlink()
    for headers in ({}, {"Range": "bytes=0-4"}):
        missing = http.get(address, headers=headers)
        assert (missing.status_code, missing.json()["code"]) == (503, "object_missing")
        assert int(missing.headers["Retry-After"]) > 0
    assert http.get(address, params={"format": "ply"}).json()["code"] == "object_missing"


def test_the_end_of_a_damaged_large_file_is_not_sent(http, folder):
    data = large(4)
    shape = stored(http, data, file_name="mesh.off", parameters=FEW)
    path_of(folder, data).write_bytes(data[:-2] + b"4\n")
    with pytest.raises(httpx.RemoteProtocolError, match=r"incomplete|without sending complete"):
        http.get(f"/v1/shapes/{shape['id']}/mesh")


def test_a_sweep_by_command(http, folder, objects_server):
    data = b"OFF\n" + TETRAHEDRON % 5
    stored(http, data, file_name="mesh.off", parameters=FEW)
    orphan = path_of(folder, b"orphan")
    orphan.parent.mkdir(exist_ok=True)
    orphan.write_bytes(b"orphan")
    sweep = ["sweep", "--library", objects_server.library, "--objects", f"file://{folder}", "--grace", 0]
    path_of(folder, b"OFF\n" + TETRAHEDRON % 3).unlink(missing_ok=True)
    found = in_process(*sweep)
    assert "1 object without a mesh (6 bytes)" in found.stdout + found.stderr
    assert orphan.exists()
    found = in_process(*sweep, "--delete", "--json")
    assert json.loads(found.stdout)["deleted"] == 1
    assert not orphan.exists()
    shutil.rmtree(path_of(folder, data).parent)
    found = in_process(*sweep)
    assert found.returncode == 4
    assert f"mesh {hashlib.sha256(data).hexdigest()} has no object" in found.stderr


def test_a_job_waits_in_the_queue_for_the_object_store(tmp_path, mock_s3, monkeypatch):
    for name, value in mock_s3.environment.items():
        monkeypatch.setenv(name, value)
    bucket, limits = mock_s3.new(), QueueLimits(queued=1)
    upload = Upload(b"OFF\n" + TETRAHEDRON % 6, "off", Parameters(samples=4))
    with Library(str(tmp_path / "library.db"), objects=bucket) as library:
        job_id = library.jobs.submit_shape(upload, ShapeRequest("a"), ANONYMOUS, limits).result().job.id
    mock_s3.refuse()
    try:
        with Server(tmp_path, workers=1, objects=bucket) as server, server.http() as http:
            end = time.monotonic() + 60
            while server.log.read_text().count("the job returns to the queue") < 2:
                assert time.monotonic() < end
                time.sleep(0.05)
            with closing(sqlite3.connect(server.library)) as connection:
                assert connection.execute("SELECT restarts, state IN ('queued', 'running') FROM jobs").fetchall() == [
                    (0, 1)
                ]
            mock_s3.accept()
            assert http.get(f"/v1/jobs/{job_id}", params={"wait": 30}).json()["state"] == "succeeded"
    finally:
        mock_s3.accept()
