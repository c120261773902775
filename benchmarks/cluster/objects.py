"""Memory and time of an upload of 200 MB: into the database, a folder, and a server that answers like S3.

python -m benchmarks.cluster.objects
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.common import BENCHMARKS, table, write_section
from tests.support.object_store import running_mock_s3
from tests.support.server import Server

_MEGABYTES = 200
_LINE = b"# unbend " + b"." * 54 + b"\n"
_TETRAHEDRON = b"4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 %d\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


def write_mesh(path: Path, height: int) -> None:
    """Write a tetrahedron with a comment of 200 MB."""
    with path.open("wb") as file:
        file.write(b"OFF\n")
        for _ in range(_MEGABYTES):
            file.write(_LINE * (2**20 // len(_LINE)))
        file.write(_TETRAHEDRON % height)


def peak_megabytes(pid: int) -> float:
    """Return the largest resident memory of a process since `forget_peak`."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 2**10


def forget_peak(pid: int) -> None:
    Path(f"/proc/{pid}/clear_refs").write_text("5")


def measure(folder: Path, mesh: Path, settings: Mapping[str, str]) -> Sequence[str]:
    """Return the growth of the server's memory in an upload, and the times of the upload and of a download."""
    with Server(folder, workers=1, max_upload_mb=256, **settings) as server, server.http() as http:
        pid = server.process.pid
        forget_peak(pid)
        before = peak_megabytes(pid)
        begin = time.perf_counter()
        with mesh.open("rb") as file:
            response = http.post("/v1/shapes", files={"file": file}, data={"parameters": '{"samples": 4}'})
        uploaded = time.perf_counter() - begin
        grown = peak_megabytes(pid) - before
        response.raise_for_status()
        job = http.get(response.headers["Location"], params={"wait": 60}).json()
        assert job["state"] == "succeeded", job
        if not settings:  # SQLite walks through all pages of a file before each piece of a large file
            return f"{grown:.0f} MB", f"{uploaded:.1f} s", ""
        begin = time.perf_counter()
        with http.stream("GET", f"/v1/shapes/{job['shape_id']}/mesh") as download:
            size = sum(len(piece) for piece in download.iter_raw())
        assert size == mesh.stat().st_size
        downloaded = time.perf_counter() - begin
        return f"{grown:.0f} MB", f"{uploaded:.1f} s", f"{downloaded:.1f} s"


def main() -> None:
    rows = []
    with tempfile.TemporaryDirectory() as name, running_mock_s3() as mock_s3:
        folder = Path(name)
        os.environ.update(mock_s3.environment)
        places = {
            "SQLite": {},
            "folder (`file://`)": {"objects": f"file://{folder}/objects"},
            "mock of S3 over loopback": {"objects": mock_s3.new()},
        }
        for number, (place, settings) in enumerate(places.items(), 1):
            mesh = folder / f"{number}.off"
            write_mesh(mesh, number)
            rows.append([place, *measure(folder / str(number), mesh, settings)])
            mesh.unlink()
    header = ["Files are in", "growth of the server's memory", "upload", "download"]
    text = table(header, rows)
    write_section(BENCHMARKS / "cluster.md", "objects", text)


if __name__ == "__main__":
    main()
