"""Clients that read their responses slowly: the server buffers little for them, and frees the buffers afterwards."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, stored
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

FEW = json.dumps(SAMPLES)
MEGABYTE = 2**20
SIZE = 8 * MEGABYTE


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    settings = {"max_answering_mb": 12, "stall_seconds": 60}
    with Server(tmp_path_factory.mktemp("slow"), workers=1, **settings) as running:
        yield running


@pytest.fixture(scope="module")
def large(server) -> str:
    """The id of a shape whose file has 8 megabytes, mostly a comment, so that it is computed quickly."""
    ring = torus(columns=10, rows=6)
    data = write_mesh(ring.vertices, ring.faces, "off") + b"# " + b"x" * SIZE + b"\n"
    with server.http() as http:
        return stored(http, data, file_name="large.off", parameters=FEW)["id"]


def resident(server: Server) -> float:
    """Return the resident memory of the server in megabytes."""
    pages = int(Path(f"/proc/{server.process.pid}/statm").read_text().split()[1])
    return pages * 4096 / MEGABYTE


@contextlib.contextmanager
def slow_readers(server: Server, path: str, count: int):
    """Open connections that request a path and read only the start of the response."""
    address = urlsplit(server.url)
    sockets = []
    try:
        for _ in range(count):
            one = socket.socket()
            one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            one.settimeout(30)
            one.connect((address.hostname, address.port))
            one.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            sockets.append(one)
        for one in sockets:
            assert one.recv(1024).startswith(b"HTTP/1.1")
        yield sockets
    finally:
        for one in sockets:
            one.close()


def test_slow_downloads_do_not_buffer_the_whole_file(server, large):
    before = resident(server)
    with slow_readers(server, f"/v1/shapes/{large}/mesh", 40):
        time.sleep(1.0)
        assert resident(server) - before < 100.0  # buffering whole files would take 40 times 8 megabytes
    end = time.monotonic() + 60.0
    while resident(server) > 1.2 * before:
        assert time.monotonic() < end, (before, resident(server))
        time.sleep(0.2)


def test_a_mesh_file_can_be_downloaded_whole_and_in_ranges(server, large):
    path = f"/v1/shapes/{large}/mesh"
    with server.http() as http:
        whole = http.get(path)
        data = whole.content
        assert len(data) == int(whole.headers["content-length"]) > SIZE
        assert whole.headers["accept-ranges"] == "bytes"
        tag = whole.headers["etag"]
        ranges = {"bytes=0-9": (0, 10), "bytes=10-": (10, len(data)), "bytes=-7": (len(data) - 7, len(data))}
        ranges |= {f"bytes=5-{10**9}": (5, len(data)), "bytes=300000-900000": (300000, 900001)}
        for asked, (begin, stop) in ranges.items():
            part = http.get(path, headers={"Range": asked})
            assert part.status_code == 206
            assert part.headers["content-range"] == f"bytes {begin}-{stop - 1}/{len(data)}"
            assert part.content == data[begin:stop]
        for beyond in (f"bytes={len(data)}-", "bytes=-0", "bytes=9-3"):
            refused = http.get(path, headers={"Range": beyond})
            problem = check(refused, 416, "range_not_satisfiable")
            assert f"{len(data)} bytes" in problem["detail"]
            assert f"0 to {len(data) - 1}" in problem["advice"]
            assert refused.headers["content-range"] == f"bytes */{len(data)}"
        for whole_again in ("bytes=0-1,3-4", "lines=0-1", "bytes=-", "nonsense"):
            assert http.get(path, headers={"Range": whole_again}).content == data
        changed = {"Range": "bytes=0-9", "If-Range": '"other"'}
        assert http.get(path, headers=changed).status_code == 200
        assert http.get(path, headers=changed | {"If-Range": tag}).status_code == 206
        assert http.get(path, headers={"If-None-Match": tag}).status_code == 304
        head = http.head(path)
        assert (head.headers["content-length"], head.headers["etag"]) == (str(len(data)), tag)


def test_a_download_is_cut_short_when_its_shape_is_removed(server):
    random = np.random.default_rng(0)
    ring = torus(columns=10, rows=6)
    comment = b"# " + random.bytes(SIZE // 2).hex().encode() + b"\n"
    with server.http() as http:
        data = write_mesh(ring.vertices, ring.faces, "off") + comment
        shape = stored(http, data, file_name="large.off", parameters=FEW)["id"]
        with slow_readers(server, f"/v1/shapes/{shape}/mesh", 1) as (reader,):
            assert http.delete(f"/v1/shapes/{shape}").status_code == 204
            taken = 0
            while piece := reader.recv(2**16):
                taken += len(piece)
        assert taken < len(data)


def test_unread_responses_are_limited_in_total_size(server, large):
    path = f"/v1/shapes/{large}/signature?format=json"
    with server.http() as http:
        assert http.get(path).status_code == 200
        sheet = torus(columns=300, rows=200)
        many = stored(http, write_mesh(sheet.vertices, sheet.faces, "ply"), parameters=FEW)["id"]
        converted = f"/v1/shapes/{many}/mesh?format=obj"
        size = len(http.get(converted).content)
        assert size > 3 * MEGABYTE
        with slow_readers(server, converted, 12 * MEGABYTE // size):
            check(http.get(converted), 503, "busy")
            assert http.get(f"/v1/shapes/{many}").status_code == 200
        end = time.monotonic() + 60.0
        while http.get(converted).status_code == 503:
            assert time.monotonic() < end
            time.sleep(0.1)


def test_json_is_compressed_when_the_client_accepts_gzip(server, large):
    address = f"{server.url}/v1/shapes/{large}/signature"
    plain = httpx.get(address, headers={"Accept-Encoding": "identity"})
    packed = httpx.get(address, headers={"Accept-Encoding": "br, gzip;q=0.5"})
    assert "content-encoding" not in plain.headers
    assert packed.headers["content-encoding"] == "gzip"
    assert "Accept-Encoding" in packed.headers["vary"]
    assert packed.num_bytes_downloaded < len(plain.content) / 2
    assert packed.json() == plain.json()
    for refused in ("gzip;q=0", "deflate", ""):
        assert "content-encoding" not in httpx.get(address, headers={"Accept-Encoding": refused}).headers
