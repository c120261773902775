"""Exact search in large libraries: the time of a query, compared with one read of the vectors, and over HTTP.

    python -m benchmarks.service.search [SHAPES]

Creates a real library in the folder for temporary files, with up to SHAPES shapes (a million by default) of random
descriptors; each shape takes two kilobytes. Includes Faiss if it is installed. Writes the section "search" of
docs/benchmarks/search.md.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx
import numpy as np
from scipy.spatial.distance import cdist

from benchmarks.common import BENCHMARKS, best_of, in_turns, table, write_section
from tests.support.server import Server
from unbend.arrays import Floats, Singles
from unbend.library import Library
from unbend.library.search.index import IndexKey, SearchIndex, Snapshot
from unbend.matching.measures import DEFAULT_MEASURE, get_vector_measure
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.shapes import sphere
from unbend.signature.parameters import Parameters
from unbend.signature.pipeline import compute_signature
from unbend.signature.signature import ALGORITHM_VERSION, Signature
from unbend.threads import available_cores

MEASURE = get_vector_measure(DEFAULT_MEASURE)
KEY = IndexKey(MEASURE, Parameters().to_json(), ALGORITHM_VERSION)
SIZES = 10_000, 100_000, 1_000_000
SERVED = {"few": 100, "many": SIZES[0]}
CHUNK = 20_000
REQUESTS = 200

NUMBERED = "WITH RECURSIVE numbers(seq) AS (VALUES(:first) UNION ALL SELECT seq + 1 FROM numbers WHERE seq < :last) "
INSERTS = (
    "INSERT INTO meshes (sha256, size, data) SELECT printf('%064x', seq), 0, x'' FROM numbers",
    (
        "INSERT INTO signatures (id, mesh_sha256, parameters, policy, version, report, area, stress, payload)"
        " SELECT seq, printf('%064x', seq), :parameters, :policy, :version, '{}', 1, 0, x'' FROM numbers"
    ),
    (
        "INSERT INTO shapes (seq, id, name, label, metadata, signature_id, created_at)"
        " SELECT seq, printf('%032x', seq), 'shape ' || seq, 'class ' || (seq % :classes), '{}', seq, 0"
        " FROM numbers"
    ),
)


def main() -> None:
    most = int(sys.argv[1]) if len(sys.argv) > 1 else SIZES[-1]
    sizes = [size for size in SIZES if size < most] + [most]
    random = np.random.default_rng(1)
    with TemporaryDirectory(prefix="unbend-search-") as folder:
        http = over_http({name: library_of(Path(folder) / name, size, random) for name, size in SERVED.items()})
        ours, others = [], []
        with Library(str(Path(folder) / "library.db")) as library:
            for size in sizes:
                fill(library, size, random)
                row, peers = measure(library, random)
                ours.append([f"{size:,}", *row])
                others.append([f"{size:,}", *peers])
    write_section(BENCHMARKS / "search.md", "search", text(ours, others, http))


def classes_of(size: int) -> int:
    return min(1000, max(100, size // 100))


def library_of(folder: Path, size: int, random: np.random.Generator) -> Path:
    """Create a library of `size` shapes in a new folder; return the folder."""
    folder.mkdir()
    with Library(str(folder / "library.db")) as library:
        fill(library, size, random)
    return folder


def fill(library: Library, size: int, random: np.random.Generator) -> None:
    """Add shapes until the library has `size` shapes."""
    width, classes = compute_signature(sphere()).descriptors[DEFAULT_MEASURE].size, classes_of(size)
    for start in range(len(library), size, CHUNK):
        insert(library, random.normal(size=(min(CHUNK, size - start), width)), classes)
    with library.store.write() as connection:
        connection.exec_driver_sql("UPDATE shapes SET label = 'class ' || (seq % ?)", (classes,))


def insert(library: Library, vectors: Floats, classes: int) -> None:
    """Add a shape for each row of `vectors`, in one transaction and without computing signatures."""
    with library.store.write() as connection:
        connection.exec_driver_sql("UPDATE library_state SET revision = revision + 1")
        last = connection.exec_driver_sql("SELECT coalesce(max(seq), 0) FROM shapes").scalar_one()
        values = {
            "first": last + 1, "last": last + len(vectors), "classes": classes, "policy": MeshPolicy().to_json(),
            "parameters": KEY.parameters, "version": KEY.version,
        }  # fmt: skip
        for statement in INSERTS:
            connection.exec_driver_sql(NUMBERED + statement, values)
        rows = [(last + 1 + row, MEASURE.name, vector) for row, vector in enumerate(vectors.astype("<f8"))]
        connection.exec_driver_sql("INSERT INTO descriptors (signature_id, measure, vector) VALUES (?, ?, ?)", rows)


def measure(library: Library, random: np.random.Generator) -> tuple[list[object], list[object]]:
    """Return one row for each table."""
    vectors, of_index = measure_index(library, random)
    query = signature_of(random.normal(size=vectors.shape[1]))
    library.rank(query)  # which loads the library's own index
    with ThreadPoolExecutor(available_cores()) as pool:
        turns = in_turns({"rank": lambda: library.rank(query), "read": lambda: read(vectors, pool)}, turns=20)
    rank, reading = turns["rank"][0], turns["read"][0]
    ours = [f"{classes_of(len(vectors)):,}", f"{rank * 1e3:.3g}", f"{reading * 1e3:.3g}", f"{rank / reading:.2f}"]
    peers = in_turns(peer_functions(vectors, MEASURE.vector(query.descriptors)), turns=2)
    return [*ours, *of_index], [f"{seconds * 1e3:.3g} ({seconds / rank:.1f})" for seconds, _ in peers.values()]


def measure_index(library: Library, random: np.random.Generator) -> tuple[Singles, list[str]]:
    """Return the vectors, and the costs of loading the index and keeping it current with the store."""
    index, before = SearchIndex(), resident_bytes()
    load = best_of(1, lambda: snapshot(library, index))
    vectors = snapshot(library, index).gallery.vectors
    resident = (resident_bytes() - before) / len(vectors)
    look = best_of(20, lambda: snapshot(library, index))
    append = min(seconds_to_append(library, index, random.normal(size=(1, vectors.shape[1]))) for _ in range(5))
    return vectors, [f"{load:.2g}", f"{resident:.0f}", f"{look * 1e6:.0f}", f"{append * 1e6:.0f}"]


def signature_of(vector: Floats) -> Signature:
    """Return a signature with only a descriptor."""
    points, faces = np.zeros((3, 3)), np.array([[0, 1, 2]])
    return Signature(points, faces, np.arange(3), np.full(3, 1 / 3), 1.0, 0.0, 0.0, {MEASURE.name: vector})


def snapshot(library: Library, index: SearchIndex) -> Snapshot:
    with library.store.read() as connection:
        return index.snapshot(connection, KEY)


def seconds_to_append(library: Library, index: SearchIndex, vector: Floats) -> float:
    """Return the time of a snapshot after one shape was added."""
    insert(library, vector, 1)
    return best_of(1, lambda: snapshot(library, index))


def read(vectors: Singles, pool: ThreadPoolExecutor) -> float:
    """Read all vectors once, by NumPy's sum on all threads."""
    return float(sum(pool.map(np.sum, np.array_split(vectors.reshape(-1), available_cores()))))


def peer_functions(vectors: Singles, query: Singles) -> dict[str, Callable[[], Any]]:
    """Return functions of other libraries that compute the same distances."""
    functions: dict[str, Callable[[], Any]] = {
        "NumPy": lambda: np.abs(vectors - query).sum(axis=1),
        "SciPy": lambda: cdist(query[None], vectors, "cityblock"),
    }
    if importlib.util.find_spec("faiss"):
        import faiss  # noqa: PLC0415

        flat = faiss.IndexFlat(vectors.shape[1], faiss.METRIC_L1)
        flat.add(vectors)
        functions["Faiss"] = lambda: flat.search(query[None], 10)
    return functions


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def over_http(folders: dict[str, Path]) -> dict[str, float]:
    """Return the median seconds of a trivial request and of a query in each folder's library, measured in turns."""
    with ExitStack() as stack:
        sends: dict[str, Callable[[], httpx.Response]] = {}
        for name, folder in folders.items():
            server = stack.enter_context(Server(folder, workers=1))
            http = stack.enter_context(httpx.Client(base_url=server.url))
            sends["livez"] = partial(http.get, "/v1/livez")
            sends[name] = partial(http.post, "/v1/queries", json={"shape_id": f"{1:032x}"})
        taken: dict[str, list[float]] = {name: [] for name in sends}
        for _ in range(REQUESTS):
            for name, send in sends.items():
                start = time.perf_counter()
                send().raise_for_status()
                taken[name].append(time.perf_counter() - start)
    return {name: float(np.median(seconds)) for name, seconds in taken.items()}


def text(ours: list[list[object]], others: list[list[object]], http: dict[str, float]) -> str:
    header = [
        "shapes",
        "classes",
        "`Library.rank`, ms",
        "NumPy sum, ms",
        "ratio",
        "load, s",
        "resident bytes per shape",
    ]
    header += ["check for changes, µs", "after one added shape, µs"]
    names = ["shapes", "NumPy, ms", "SciPy cdist, ms"]
    if importlib.util.find_spec("faiss"):
        names.append(f"Faiss {importlib.metadata.version('faiss-cpu')} IndexFlat, 10 nearest, ms")
    livez, few, many = (f"{http[name] * 1e3:.2f} ms" for name in ("livez", "few", "many"))
    return f"""A query by a signature (`{MEASURE.name}`) in a library of stored shapes, {available_cores()} threads, compared with NumPy's sum of the same number of vectors on the same number of threads; the quickest of 20 in turns.

{table(header, ours)}

**Other ways to compute the same distances**, without classes, names or a store (in brackets: the ratio to our time).

{table(names, others)}

**Over HTTP**, loopback, one connection, medians of {REQUESTS}: `GET /v1/livez` {livez}; `POST /v1/queries` by a stored shape among {SERVED["few"]:,} shapes {few}, among {SERVED["many"]:,} {many} (both responses: {classes_of(SIZES[0])} classes and ten shapes), in turns."""  # noqa: E501


if __name__ == "__main__":
    main()
