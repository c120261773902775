"""Make the dump of a small library, by the code of the version that is on the path.

    git worktree add /tmp/old COMMIT
    PYTHONPATH=/tmp/old/service python tests/library/released/make.py tests/library/released/000N.sql

It holds shapes, one changed and one removed since; a job in each state, of both kinds; and keys, if that version has
them. Old versions' kernels can be spared their compilation with NUMBA_DISABLE_JIT=1.
"""

from __future__ import annotations

import asyncio
import dataclasses
import importlib.util
import sqlite3
import sys
import tempfile
from pathlib import Path

from unbend import Library, Parameters, Signature, compute_signature, read_mesh
from unbend.jobs import JobRunner, Upload
from unbend.library import queue
from unbend.library import shapes as rows

FEW = Parameters(samples=6)
QUERY = {"measure": "spectrum", "k": 10}


def octahedron(height: float) -> bytes:
    """An off file of 6 vertices, another one for each height."""
    corners = f"1 0 0\n-1 0 0\n0 1 0\n0 -1 0\n0 0 {height}\n0 0 -1\n"
    return f"OFF\n6 8 0\n{corners}3 0 2 4\n3 2 1 4\n3 1 3 4\n3 3 0 4\n3 2 0 5\n3 1 2 5\n3 3 1 5\n3 0 3 5\n".encode()


def upload(height: float) -> Upload:
    """A file to compute, read as it is by default."""
    values = {"data": octahedron(height), "file_type": "off", "parameters": FEW}
    if "policy" in {field.name for field in dataclasses.fields(Upload)}:
        from unbend import MeshPolicy

        values["policy"] = MeshPolicy()
    return Upload(**values)


def stored_as(signature: Signature) -> object:
    """A signature as that version takes it to be stored."""
    from unbend.library import payload

    return payload.PackedSignature.of(signature) if hasattr(payload, "PackedSignature") else signature


def about(name: str) -> dict[str, object]:
    """What an upload says of its shape."""
    return {"name": name, "label": "octahedron", "metadata": {"täg": [1, None]}}


async def fill(library: Library) -> None:
    """Store shapes and jobs, as the service of that version does."""
    runner = JobRunner(library, workers=1)
    flat = library.add(octahedron(0.5), name="flät/=1", label="octahedron", parameters=FEW)
    library.change(flat.id, {"label": "pressed", "metadata": {"seen": True}})
    gone = library.add(octahedron(0.8), name="gone", label="octahedron", parameters=FEW)
    library.remove(gone.id)

    async def claimed(kind: str, height: float, request: dict[str, object]) -> str:
        job = await runner.submit(kind, upload(height), request)
        with library.store.write() as connection:
            assert queue.claim(connection).id == job.id
        return job.id

    def end(job_id: str, state: str, **values: object) -> None:
        with library.store.write() as connection:
            assert queue.finish(connection, job_id, state, **values)

    stored = await claimed("shape", 1.0, about("uploaded"))
    surface = read_mesh(octahedron(1.0))
    with library.store.write() as connection:
        job = queue.get_job(connection, stored)
        values = {
            "sha256": job.mesh_sha256, "signature": stored_as(compute_signature(surface, FEW)), "area": surface.area,
            "report": surface.report.as_dict(), **job.request,
        }  # fmt: skip
        if "policy" in {field.name for field in dataclasses.fields(rows.NewShape)}:
            values["policy"] = upload(1.0).policy
        added = rows.add_shape(connection, rows.NewShape(**values))
        queue.finish(connection, stored, "succeeded", shape_id=getattr(added, "id", added))
    answered = await claimed("query", 1.1, QUERY)
    end(answered, "succeeded", result=library.rank(compute_signature(read_mesh(octahedron(1.1)), FEW), k=10).as_dict())
    error = {"code": "mesh_read", "message": "the file ends early", "advice": "Export it again."}
    end(await claimed("shape", 1.2, about("broken")), "failed", error=error)
    end(await claimed("query", 1.3, QUERY), "cancelled", error=error)
    await runner.submit("shape", upload(1.4), about("running"))
    await runner.submit("shape", upload(1.5), about("waiting"))
    await runner.submit("query", upload(1.6), QUERY)
    await runner.stop()  # puts what runs back into the queue
    with library.store.write() as connection:
        queue.claim(connection)


def add_keys(library: Library) -> None:
    """A live key and a revoked one, if there are keys."""
    if importlib.util.find_spec("unbend.library.keys"):
        from unbend.library.keys import create_key, revoke_key

        with library.store.write() as connection:
            create_key(connection, "live", "write")
            revoke_key(connection, create_key(connection, "revoked", "read")[0].id)


def main() -> None:
    """Write the dump that the command line names."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "library.db"
        with Library(str(path)) as library:
            asyncio.run(fill(library))
            add_keys(library)
        made = sqlite3.connect(path)
        Path(sys.argv[1]).write_text("".join(f"{line}\n" for line in made.iterdump()), encoding="utf-8")
        made.close()


if __name__ == "__main__":
    main()
