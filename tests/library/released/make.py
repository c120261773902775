"""Write the dump of a small library of this version.

    PYTHONPATH=service python tests/library/released/make.py tests/library/released/000N.sql

The library contains two shapes (a third was removed, one was changed), jobs of both kinds in every state, an active key
and a revoked key. Each earlier dump was written by the version of this script at that time.
"""

from __future__ import annotations

import sqlite3
import sys
import tempfile
from concurrent.futures import Future
from pathlib import Path
from typing import TypeVar

from unbend import Library, Parameters, compute_signature, read_mesh
from unbend.errors import MeshReadError
from unbend.jobs.failures import describe
from unbend.jobs.worker import StoredMesh, compute_shape
from unbend.library.jobs import ANONYMOUS, NewJob, QueueLimits
from unbend.library.records import JobRecord
from unbend.library.requests import QueryRequest, ShapeRequest, Upload

T = TypeVar("T")

FEW = Parameters(samples=6)
LIMITS = QueueLimits(queued=100)


def octahedron(height: float) -> bytes:
    """Return an off file of an octahedron, different for each height."""
    corners = f"1 0 0\n-1 0 0\n0 1 0\n0 -1 0\n0 0 {height}\n0 0 -1\n"
    return f"OFF\n6 8 0\n{corners}3 0 2 4\n3 2 1 4\n3 1 3 4\n3 3 0 4\n3 2 0 5\n3 1 2 5\n3 3 1 5\n3 0 3 5\n".encode()


def described(name: str) -> ShapeRequest:
    """Return the request of an upload."""
    return ShapeRequest(name, "octahedron", {"täg": [1, None]})


def submit(library: Library, height: float, request: ShapeRequest | QueryRequest) -> None:
    """Queue a job."""
    upload = Upload(octahedron(height), "off", FEW)
    if isinstance(request, ShapeRequest):
        outcome = library.jobs.submit_shape(upload, request, ANONYMOUS, LIMITS).result()
    else:
        outcome = library.jobs.submit_query(upload, request, ANONYMOUS, LIMITS).result()
    assert isinstance(outcome, NewJob)


def started(library: Library, height: float, request: ShapeRequest | QueryRequest) -> JobRecord:
    """Queue a job and start it."""
    submit(library, height, request)
    return done(library.jobs.claim())


def done(future: Future[T | None]) -> T:
    """Return the result of a transaction, which must not be None."""
    result = future.result()
    assert result is not None
    return result


def fill(library: Library) -> None:
    """Store shapes, jobs and keys."""
    flat = library.add(octahedron(0.5), name="flät/=1", label="octahedron", parameters=FEW)
    library.change(flat.id, label="pressed", metadata={"seen": True})
    library.remove(library.add(octahedron(0.8), name="gone", label="octahedron", parameters=FEW).id)
    uploaded = started(library, 1.0, described("uploaded"))
    mesh = StoredMesh(library.address, uploaded.mesh_sha256 or "", "off", uploaded.policy)
    done(library.jobs.complete_shape(uploaded, compute_shape(mesh, FEW).shape))
    answered = started(library, 1.1, QueryRequest())
    signature = compute_signature(read_mesh(octahedron(1.1)), FEW)
    done(library.jobs.complete_query(answered, library.search.rank(signature, QueryRequest())))
    error = describe(MeshReadError("the file ends early"))
    done(library.jobs.fail(started(library, 1.2, described("broken")), error, None))
    done(library.jobs.cancel(started(library, 1.3, QueryRequest()).id, error, None))
    started(library, 1.4, described("running"))
    submit(library, 1.5, described("waiting"))
    submit(library, 1.6, QueryRequest())
    library.keys.create("live", "write")
    library.keys.revoke(library.keys.create("revoked", "read")[0].id)


def main() -> None:
    """Write the dump to the path given on the command line."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "library.db"
        with Library(str(path)) as library:
            fill(library)
        made = sqlite3.connect(path)
        Path(sys.argv[1]).write_text("".join(f"{line}\n" for line in made.iterdump()), encoding="utf-8")
        made.close()


if __name__ == "__main__":
    main()
