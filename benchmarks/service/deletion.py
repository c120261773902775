"""The time of secure deletion: overwriting content, and emptying the write-ahead log.

    python -m benchmarks.service.deletion

For files of three sizes, prints the milliseconds that the store takes for a query's file, from the upload to the end of
its job, and for removing a shape. Each is measured three times: as the library deletes, without emptying the log, and
without either emptying the log or overwriting content.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
from sqlalchemy import event

from unbend import Library, Parameters, Signature
from unbend.library import job_rows, shape_rows
from unbend.library.packing import PackedSignature
from unbend.library.requests import QueryRequest, ShapeRequest, Upload
from unbend.library.shape_rows import ComputedShape

SIZES = {"20 kB": 20_000, "1 MB": 1_000_000, "20 MB": 20_000_000}
ROUNDS = 15
FEW = Parameters(samples=40)


def run_query(library: Library, data: bytes) -> None:
    key = Upload(data, "off", FEW).key
    with library.store.write() as connection:
        shape_rows.put_mesh(connection, key.sha256, data)
        job = job_rows.enqueue(connection, job_id=job_rows.new_id(), key=key, file_type="off", request=QueryRequest())
    with library.store.write() as connection:
        job_rows.claim(connection)
    with library.store.write() as connection:
        job_rows.finish(connection, job.id, "succeeded")


def add(library: Library, data: bytes) -> str:
    corners, face = np.zeros((3, 3)), np.array([[0, 1, 2]])
    vectors = {"spectrum": np.zeros(160)}
    signature = Signature(corners, face, np.arange(3), np.full(3, 1 / 3), 1.0, 0.0, 0.0, vectors, FEW)
    computed = ComputedShape(Upload(data, "off", FEW).key, PackedSignature.of(signature), area=1.0, report={})
    return library.shapes.submit(computed, ShapeRequest("shape", "class"), lambda: data).result().id


def milliseconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return 1000 * (time.perf_counter() - start)


def measured(path: Path, size: int, *, overwritten: bool, log_emptied: bool) -> tuple[float, float]:
    """Return the median milliseconds of a query and of a removal."""
    with Library(str(path)) as library:
        if not overwritten:
            engine = library.store._engine  # noqa: SLF001
            event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA secure_delete = OFF"))
            engine.dispose()
        if not log_emptied:
            library.store.erase = lambda _urgency: None
        queries, removals = [], []
        for _ in range(ROUNDS):
            query, shape = os.urandom(size), os.urandom(size)
            queries.append(milliseconds(lambda data=query: run_query(library, data)))
            shape_id = add(library, shape)
            removals.append(milliseconds(lambda which=shape_id: library.remove(which)))
    return median(queries), median(removals)


def main() -> None:
    print(f"| file | {'':<34} | a query, ms | a removal, ms |")
    ways = {
        "overwritten, log emptied": {"overwritten": True, "log_emptied": True},
        "overwritten, log left": {"overwritten": True, "log_emptied": False},
        "not overwritten, log left": {"overwritten": False, "log_emptied": False},
    }
    for size_name, size in SIZES.items():
        for way, options in ways.items():
            with tempfile.TemporaryDirectory() as folder:
                query, removal = measured(Path(folder) / "library.db", size, **options)
            print(f"| {size_name} | {way:<34} | {query:.1f} | {removal:.1f} |", flush=True)


if __name__ == "__main__":
    main()
