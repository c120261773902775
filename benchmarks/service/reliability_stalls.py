"""How long expensive requests delay a probe, on a server with many shapes and a long history."""

from __future__ import annotations

import contextlib
import hashlib
import socket
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final
from urllib.parse import quote, urlsplit

import numpy as np
from sqlalchemy import Connection

from benchmarks.common import table
from benchmarks.service.reliability_kills import Report, progress
from tests.support.server import Server, small_mesh
from tests.support.watchdog import watchdog
from unbend import Library, MeshPolicy, Parameters, compute_signature, read_mesh
from unbend.library import job_rows, shape_rows
from unbend.library.packing import PackedSignature
from unbend.library.requests import QueryRequest, ShapeRequest, Upload, UploadKey
from unbend.library.shape_rows import ComputedShape
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

SHAPES: Final = 6000
JOBS: Final = 20_000
LARGE_BYTES: Final = 30 * 2**20
READERS: Final = 60
FEW: Final = quote('{"samples": 40}')
LONGEST: Final = 0.25
"""Longest allowed delay of the probe, in seconds."""

BACK: Final = 1.2
"""Allowed ratio of the server's memory one minute after the requests to its memory before them."""


def stall(seed: int) -> Report:
    """Send expensive requests to a server, and measure the delays of a concurrent probe."""
    with TemporaryDirectory() as folder:
        ids, large = _fill(Path(folder) / "library.db", seed)
        progress("stalls: the library is filled")
        with Server(Path(folder), stall_seconds=90) as server, server.http() as http:
            for path in (f"map?parameters={FEW}", "classes", f"shapes/{ids[0]}"):
                http.get(f"/v1/{path}").raise_for_status()
            http.post("/v1/queries", json={"shape_id": ids[0]}).raise_for_status()
            before = most = _resident(server)
            longest: dict[str, tuple[float, float]] = {}
            for name, act in _acts(server, ids, large).items():
                begun = time.monotonic()
                with watchdog(server) as stalls:
                    act()
                most = max(most, _resident(server))
                longest[name] = stalls.longest, time.monotonic() - begun
                progress(f"stalls: {name}: {stalls.longest:.3f} s, {stalls.failed} failed")
            time.sleep(60.0)
            after = _resident(server)
    faults = [f"{name}: a probe waited {took:.2f} s" for name, (took, _) in longest.items() if took > LONGEST]
    faults += [f"memory: {before:.0f} MB before, {after:.0f} MB a minute after"] * (after > BACK * before)
    rows = [[name, f"{took:.3f}", f"{lasted:.1f}"] for name, (took, lasted) in longest.items()]
    text = (
        f"A server has 2 workers, {SHAPES:,} shapes and a history of {JOBS:,} jobs. A probe requested `/v1/livez` "
        "up to a hundred times a second during each request of the table.\n\n"
        + table(["concurrent request", "longest response time of the probe, s", "duration, s"], rows)
        + f"\n\nMemory of the server's main process: {before:.0f} MB before, at most {most:.0f} MB after a request, "
        f"{after:.0f} MB a minute after the last."
    )
    return Report(text, faults)


def _fill(path: Path, seed: int) -> tuple[list[str], str]:
    """Create a library of many shapes and jobs; return the ids of the small shapes and of the large shape."""
    few = Parameters(samples=40)
    packed = PackedSignature.of(compute_signature(read_mesh(small_mesh(0)), few))
    random = np.random.default_rng(seed)
    with Library(str(path)) as library:
        with library.store.write() as connection:
            ids = [
                _add(connection, packed, b"%d" % number, f"class {number % 300}", random) for number in range(SHAPES)
            ]
        surface = torus(columns=10, rows=6)
        data = write_mesh(surface.vertices, surface.faces, "off") + b"# " + b"x" * LARGE_BYTES + b"\n"
        large = library.add(data, name="large", parameters=few).id
        answer = library.rank(ids[0], k=50).as_dict()
        for _ in range(JOBS // 1000):
            with library.store.write() as connection:
                for number in range(1000):
                    _answer(connection, number, answer, few)
    return ids, large


def _add(connection: Connection, packed: PackedSignature, data: bytes, label: str, random: np.random.Generator) -> str:
    vectors = {
        name: (np.frombuffer(vector, "<f8") * random.normal(1.0, 0.05, len(vector) // 8)).astype("<f8").tobytes()
        for name, vector in packed.vectors.items()
    }
    key = UploadKey(hashlib.sha256(data).hexdigest(), packed.parameters, MeshPolicy().to_json(), packed.version)
    shape_rows.put_mesh(connection, key.sha256, data)
    changed = PackedSignature(packed.parameters, packed.version, packed.stress, packed.payload, vectors)
    computed = ComputedShape(key, changed, area=1.0, report={"file_type": "off"})
    return shape_rows.add_shape(connection, computed, ShapeRequest("shape", label)).id


def _answer(connection: Connection, number: int, answer: dict, parameters: Parameters) -> None:
    key = Upload(b"query %d" % number, "off", parameters).key
    shape_rows.put_mesh(connection, key.sha256, b"query %d" % number)
    job = job_rows.enqueue(connection, job_id=job_rows.new_id(), key=key, file_type="off", request=QueryRequest())
    job_rows.claim(connection)
    job_rows.finish(connection, job.id, "succeeded", result=answer)


def _acts(server: Server, ids: list[str], large: str) -> dict[str, Callable[[], object]]:
    json_type = {"Content-Type": "application/json"}

    def call(method: str, path: str, **options: object) -> Callable[[], object]:
        def act() -> None:
            with server.http() as http:
                http.request(method, f"/v1/{path}", **options)

        return act

    def keys(count: int) -> bytes:
        return b"{" + b",".join(b'"k%d":1' % number for number in range(count)) + b"}"

    def pages() -> None:
        with server.http() as http:
            cursor = None
            for _ in range(SHAPES // 500):
                cursor = http.get("/v1/shapes", params={"limit": 500} | ({"cursor": cursor} if cursor else {})).json()[
                    "next_cursor"
                ]

    def removals() -> None:
        with server.http() as http:
            for shape_id in ids[:20]:
                http.delete(f"/v1/shapes/{shape_id}")

    def queries() -> None:
        with server.http() as http:
            for shape_id in ids[20:40]:
                http.post("/v1/queries", json={"shape_id": shape_id, "k": 1000})

    now = {"before": datetime.now(UTC).isoformat()}
    form = {"files": {"file": ("m.ply", small_mesh(1))}, "data": {"metadata": keys(80_000).decode()}}
    return {
        "1 MB of unknown keys to /queries": call("POST", "queries", content=keys(100_000), headers=json_type),
        "7 MB of unknown keys in a PATCH": call("PATCH", f"shapes/{ids[0]}", content=keys(600_000), headers=json_type),
        "59 kB of unknown keys in a PATCH": call("PATCH", f"shapes/{ids[0]}", content=keys(6_000), headers=json_type),
        "64 kB of nested lists": call("POST", "queries", content=b"[" * 65_000, headers=json_type),
        "a form with 0.9 MB of metadata": call("POST", "shapes", **form),
        "a URL of 15 kB": call("GET", "shapes?" + "&".join(f"k{n}=1" for n in range(2000))),
        "all shapes, in pages of 500": pages,
        "500 jobs": call("GET", "jobs?limit=500"),
        "20 queries for the nearest 1000": queries,
        "a map of 5000 shapes": call("GET", f"map?parameters={FEW}"),
        "an evaluation": call("GET", f"evaluation?parameters={FEW}"),
        "a download of 30 MB": call("GET", f"shapes/{large}/mesh"),
        f"{READERS} slow downloads of 30 MB": lambda: _slowly(server, f"/v1/shapes/{large}/mesh"),
        "20 shapes removed": removals,
        "the large shape removed": call("DELETE", f"shapes/{large}"),
        "all jobs forgotten": call("DELETE", "jobs", params=now),
    }


def _slowly(server: Server, path: str) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(READERS):
            one = stack.enter_context(_reader(server, path))
            one.recv(1024)
        for _ in range(10):
            time.sleep(1.0)


@contextlib.contextmanager
def _reader(server: Server, path: str) -> Iterator[socket.socket]:
    address = urlsplit(server.url)
    with socket.socket() as one:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        one.settimeout(60)
        one.connect((address.hostname, address.port))
        one.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        yield one


def _resident(server: Server) -> float:
    pages = int(Path(f"/proc/{server.process.pid}/statm").read_text().split()[1])
    return pages * 4096 / 2**20
