"""Approximate search by PostgreSQL with pgvector: recall, time, size, filters, inserts and class answers.

    python -m benchmarks.cluster.search [SIZE ...]

SIZE is a number of vectors, 100,000 and 1,000,000 by default. A million vectors take 4 GB in the folder for temporary
files and 3 GB of memory. The results of each size are kept in the folder for temporary files, and the page has those of
all sizes, so that they may be measured one at a time.

The vectors are drawn from real ones, as `benchmarks/cluster/descriptors.py` says: made-up classes between two real
shapes of different classes, each with random poses that have the covariance of real poses. Queries are new poses of
stored classes, and for one in ten of no stored class. No query is a stored vector. The real descriptors are computed
once, and kept in the folder for temporary files.

The truth is the exact scan of the index in memory. Recall at 10 is the share of the ten truly nearest shapes that a
search returns. The times of a search include the transfer of the candidates and their exact order. Queries run one
after the other, on one connection; a process of its own adds shapes meanwhile where the text says so. Writes the
section "approximate-search" of docs/benchmarks/cluster-search.md.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Engine, text

from benchmarks.cluster.database import KIND, NUMBERS, ROWS, database, fill_library, label_of, values
from benchmarks.cluster.descriptors import MEASURE, Drawn, Real, draw, real
from benchmarks.common import BENCHMARKS, table, write_section
from unbend.library.search.nearest import EVERY, Filter, find_nearest
from unbend.library.search.nearest_classes import classify_nearest, draw_samples
from unbend.library.vector_rows import (
    Partition,
    as_text,
    build_indexes,
    find_partition,
    from_bytes,
    searched_metadata,
    vectors,
)
from unbend.matching.classification import classify
from unbend.matching.gallery import Gallery
from unbend.matching.scan import scan
from unbend.matching.selection import smallest
from unbend.threads import available_cores

SIZES = 100_000, 1_000_000
QUERIES = 200
K = 10
MEMORY_MB = 2048
SETTINGS = {"shared_buffers": "4GB", "max_wal_size": "16GB", "maintenance_work_mem": f"{MEMORY_MB}MB"}
SEARCHES = (40, 100, 200, 400)
"""Values of hnsw.ef_search."""
CANDIDATES = 100
"""Largest number of candidates that are ordered again."""
CHOSEN = "halfvec", 16, 64
GRID = {
    "few": [("vector", 16, 64), ("halfvec", 8, 64), ("halfvec", 16, 128), ("halfvec", 24, 128), CHOSEN],
    "many": [CHOSEN],
}
"""Type, m and ef_construction of the indexes, below a million vectors and from there."""
WRITING_SECONDS = 20
KEPT = "unbend-cluster-search-{size}.json"
FILTERED = 50
"""Queries with each filter."""


@dataclass(frozen=True)
class Truth:
    """Made-up vectors, and the exact answers of the index in memory."""

    drawn: Drawn
    distances: list[np.ndarray]
    """The distances of each query to all vectors."""
    seconds: float
    """Median time of a scan and the choice of the nearest."""

    @classmethod
    def of(cls, drawn: Drawn) -> Truth:
        scan(drawn.queries[0], drawn.vectors)  # which compiles
        distances, seconds = [], []
        for query in drawn.queries:
            start = time.perf_counter()
            found = scan(query, drawn.vectors)
            smallest(found, K)
            seconds.append(time.perf_counter() - start)
            distances.append(found.astype(np.float32))
        return cls(drawn, distances, float(np.median(seconds)))

    def nearest(self, query: int, kept: np.ndarray | None = None) -> set[int]:
        """Return the seqs of the shapes nearest to a query, among those `kept` (n,)."""
        distances = self.distances[query].astype(float)
        if kept is not None:
            distances[~kept] = np.inf
        return set((smallest(distances, K) + 1).tolist())


@dataclass
class Tally:
    """Recalls and times of one way to search."""

    recalls: list[float]
    seconds: list[float]
    processor: float = 0.0
    """Mean seconds of the processor, in the client and in the server's process of its connection."""

    @property
    def cells(self) -> list[str]:
        milliseconds = np.array(self.seconds) * 1e3
        return [
            f"{np.mean(self.recalls):.4f}",
            f"{np.median(milliseconds):.1f}",
            f"{np.quantile(milliseconds, 0.99):.1f}",
        ]


def tally(
    truth: Truth,
    ask: Callable[[int], Sequence[int]],
    kept: Callable[[int], np.ndarray | None],
    asked: int,
    server: int = 0,
) -> Tally:
    """Ask the first queries; `ask` returns seqs for a query, and `kept` says which shapes its filter keeps."""
    ask(0)
    found = Tally([], [])
    for query in range(asked):
        start, used = time.perf_counter(), used_seconds(server)
        seqs = ask(query)
        found.seconds.append(time.perf_counter() - start)
        found.processor += (used_seconds(server) - used) / asked
        true = truth.nearest(query, kept(query))
        found.recalls.append(len(true & set(seqs)) / len(true))
    return found


def used_seconds(server: int) -> float:
    """Return the time of the processor that this process and another one have used."""
    if not server:
        return time.process_time()
    fields = Path(f"/proc/{server}/stat").read_text().rpartition(")")[2].split()
    return time.process_time() + (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    sizes = [int(each) for each in sys.argv[1:]] or SIZES
    base = real(Path(tempfile.gettempdir()) / "unbend-real-descriptors.npz")
    for size in sizes:
        (Path(tempfile.gettempdir()) / KEPT.format(size=size)).write_text(json.dumps(measured(base, size)))
    write_page(base)


def write_page(base: Real) -> None:
    """Write the page of all results that were kept."""
    files = Path(tempfile.gettempdir()).glob(KEPT.format(size="*"))
    found = sorted((json.loads(file.read_text()) for file in files), key=itemgetter("size"))
    write_section(BENCHMARKS / "cluster-search.md", "approximate-search", page(base, found))


def measured(base: Real, size: int) -> dict[str, Any]:
    truth = Truth.of(draw(base, size, QUERIES, seed=size))
    with database(SETTINGS) as engine:
        partition = fill_library(engine, truth.drawn)
        found: dict[str, Any] = {"size": size, "memory": truth.seconds, "likeness": likeness(truth)}
        log(f"{size:,} vectors are stored")
        build_indexes(engine, least=size + 1)  # of metadata
        found["table"] = relation_bytes(engine, "vectors") / size
        found["scan"] = module(engine, partition, truth, exact=True, asked=50).cells
        log(f"plain scan {found['scan']}")
        found["grid"] = [
            row for each in GRID["many" if size >= SIZES[-1] else "few"] for row in grid(engine, partition, truth, each)
        ]
        with engine.connect() as connection:
            partition = find_partition(connection, KIND) or partition
        chosen = module(engine, partition, truth)
        found["chosen"] = [*chosen.cells, f"{chosen.processor * 1e3:.1f}"]
        log(f"chosen {found['chosen']}")
        found["filters"] = filters(engine, partition, truth)
        found["classes"] = classes(engine, partition, truth)
        found["writing"] = writing(engine, partition, truth)
        found["load"] = os.getloadavg()[1]
    return found


def relation_bytes(engine: Engine, name: str) -> int:
    """Return the size of a table without its indexes, or of an index."""
    with engine.connect() as connection:
        return int(connection.scalar(text("SELECT pg_table_size(CAST(:name AS regclass))"), {"name": name}))


def likeness(truth: Truth) -> list[float]:
    """Return the median distances of queries from the nearest shape of their class, and from the nearest other."""
    own, other = [], []
    for distances, code in zip(truth.distances, truth.drawn.query_codes, strict=True):
        same = truth.drawn.codes == code
        if same.any():
            own.append(distances[same].min())
            other.append(distances[~same].min())
    return [float(np.median(own)), float(np.median(other))]


def module(
    engine: Engine,
    partition: Partition,
    truth: Truth,
    only: Filter = EVERY,
    kept: np.ndarray | None = None,
    *,
    exact: bool = False,
    asked: int = QUERIES,
) -> Tally:
    """Measure `find_nearest`; `kept` says which shapes the filter keeps."""
    with engine.connect() as connection:

        def ask(query: int) -> list[int]:
            with connection.begin():
                found = find_nearest(connection, partition, truth.drawn.queries[query], K, only, exact=exact)
            return found.seqs.tolist()

        server = connection.scalar(text("SELECT pg_backend_pid()")) or 0
        connection.rollback()
        return tally(truth, ask, lambda _: kept, asked, server)


def grid(engine: Engine, partition: Partition, truth: Truth, index: tuple[str, int, int]) -> Iterator[list[str]]:
    """Build an index; yield a row of the table for each ef_search, and drop the index unless it is the chosen one."""
    kind, m, ef_construction = index
    half = f"CAST(embedding AS {kind}(120))"
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        start = time.perf_counter()
        if index == CHOSEN:
            build_indexes(engine, least=1, memory_mb=MEMORY_MB)
            name = partition.index
        else:
            name = "measured"
            connection.execute(
                text(
                    f"CREATE INDEX measured ON vectors USING hnsw ({half} {kind}_l1_ops)"
                    f" WITH (m = {m}, ef_construction = {ef_construction}) WHERE partition_id = 1"
                )
            )
        build = time.perf_counter() - start
        size = relation_bytes(engine, name) / len(truth.drawn.vectors)
        for ef_search in SEARCHES:
            connection.execute(text(f"SET hnsw.ef_search = {ef_search}"))
            statement = text(
                f"SELECT seq, vector_send(embedding) FROM vectors WHERE partition_id = 1"  # noqa: S608
                f" ORDER BY {half} <+> CAST(:query AS {kind}(120)) LIMIT {min(ef_search, CANDIDATES)}"
            )
            firsts: dict[int, set[int]] = {}

            def ask(query: int, statement: Any = statement, firsts: dict[int, set[int]] = firsts) -> list[int]:
                vector = truth.drawn.queries[query]
                rows = connection.execute(statement, {"query": as_text(vector)}).all()
                firsts[query] = {row.seq for row in rows[:K]}
                found = from_bytes([row.vector_send for row in rows], 120)
                return [rows[place].seq for place in smallest(scan(vector, found), K)]

            ordered = tally(truth, ask, lambda _: None, QUERIES)
            raw = np.mean([len(truth.nearest(query) & found) / K for query, found in firsts.items()])
            yield [
                f"{len(truth.drawn.vectors):,}", kind, str(m), str(ef_construction), f"{build:.0f}", f"{size:.0f}",
                str(ef_search), f"{raw:.4f}", *ordered.cells,
            ]  # fmt: skip
            log(f"{index} {ef_search} {raw:.4f} {ordered.cells} build {build:.0f} s, {size:.0f} bytes")
        connection.execute(text("DROP INDEX IF EXISTS measured"))


WAYS = {
    "HNSW, then the filter": "off",
    "iterative, strict_order": "strict_order",
    "iterative, relaxed_order": "relaxed_order",
}


def filters(engine: Engine, partition: Partition, truth: Truth) -> list[list[str]]:
    """Return a row for each filter and way to search with it."""
    codes, parts = truth.drawn.codes, np.random.default_rng(5).integers(0, 1000, len(truth.drawn.codes))
    cases: dict[str, tuple[Filter, np.ndarray]] = {
        "one label": (Filter(label=label_of(3)), codes == 3),
        "metadata": (Filter(metadata={"hundredth": 7}), parts % 100 == 7),
        "metadata, 0.1 %": (Filter(metadata={"thousandth": 7}), parts == 7),
        "metadata, 10 %": (Filter(metadata={"tenth": 7}), parts % 10 == 7),
    }
    rows = []
    for name, (only, kept) in cases.items():
        for way, setting in WAYS.items():
            found = filtered(engine, partition, truth, only, kept, setting)
            rows.append([f"{len(codes):,}", name, f"{kept.sum():,}", way, *found])
            log(str(rows[-1]))
        for way, exact in (("exact, all that the filter keeps", True), ("as the service chooses", False)):
            found = module(engine, partition, truth, only, kept, exact=exact, asked=FILTERED).cells
            rows.append([f"{len(codes):,}", name, f"{kept.sum():,}", way, f"{K:.1f}", *found])
            log(str(rows[-1]))
    return rows


def filtered(
    engine: Engine, partition: Partition, truth: Truth, only: Filter, kept: np.ndarray, setting: str
) -> list[str]:
    """Return the mean number of shapes found, recall and times of an approximate search with a filter."""
    half = f"CAST(vectors.embedding AS halfvec({partition.dimensions}))"
    kept_by = (
        f"label = '{only.label}'"
        if only.label
        else f"{searched_metadata('shapes')} @> '{json.dumps(dict(only.metadata))}'"
    )
    statement = (
        f"SELECT vectors.seq, vector_send(embedding) FROM vectors JOIN shapes ON shapes.seq = vectors.seq"  # noqa: S608
        f" WHERE partition_id = {partition.id} AND {kept_by} ORDER BY {half} <+> CAST(%s AS halfvec(120)) LIMIT {3 * K}"
    )
    counts: list[int] = []
    with engine.connect() as connection:
        driver: Any = connection.connection.driver_connection
        driver.execute(f"SET hnsw.iterative_scan = {setting}")
        driver.execute("SET hnsw.ef_search = 100")
        # The planner may prefer to sort what the filter keeps, which is the exact way.
        driver.execute("SET enable_sort = off")

        def ask(query: int) -> list[int]:
            vector = truth.drawn.queries[query]
            rows = driver.execute(statement, (as_text(vector),)).fetchall()
            if not rows:
                return []
            counts.append(min(len(rows), K))
            found = from_bytes([row[1] for row in rows], 120)
            return [rows[place][0] for place in smallest(scan(vector, found), K)]

        found = tally(truth, ask, lambda _: kept, FILTERED)
        driver.rollback()
    return [f"{sum(counts) / (FILTERED + 1):.1f}", *found.cells]


def classes(engine: Engine, partition: Partition, truth: Truth) -> list[list[str]]:
    """Return a row for each classifier: how often the database's answer equals that of the index in memory."""
    drawn = truth.drawn
    labels = tuple(label_of(code) for code in range(int(drawn.codes.max()) + 1))
    gallery = Gallery(drawn.vectors, drawn.codes.astype(np.int32), labels)
    rows = []
    with engine.connect() as connection:
        start = time.perf_counter()
        with connection.begin():
            samples = draw_samples(connection, partition)
        drawing = time.perf_counter() - start
        for classifier, candidates in (("nearest", 300), ("nearest", 1000), ("vote", 300), ("vote", 1000)):
            same, known, near, errors, seconds = [], [], [], [], []
            for query, distances in zip(drawn.queries, truth.distances, strict=True):
                start = time.perf_counter()
                with connection.begin():
                    ours = classify_nearest(connection, partition, query, samples, classifier, candidates=candidates)
                seconds.append(time.perf_counter() - start)
                full = classify(gallery, MEASURE, query, distances.astype(float), classifier)
                same.append(ours.matches[0].label == full.matches[0].label)
                known.append(ours.known == full.known)
                error = abs(ours.matches[0].confidence - full.matches[0].confidence)
                near.append(error < 0.01)
                errors.append(error)
            rows.append([
                f"{len(drawn.vectors):,}", f"{len(labels):,}", classifier, str(candidates), f"{np.mean(same):.3f}",
                f"{np.mean(known):.3f}", f"{np.mean(near):.3f}", f"{np.max(errors):.3f}",
                f"{np.median(seconds) * 1e3:.0f}",
                f"{np.quantile(seconds, 0.99) * 1e3:.0f}", f"{len(samples.vectors):,}", f"{drawing:.1f}",
            ])  # fmt: skip
            log(str(rows[-1]))
    return rows


def writing(engine: Engine, partition: Partition, truth: Truth) -> list[list[str]]:
    """Return a row for each number of shapes that a transaction adds: shapes a second, and queries meanwhile."""
    rows = []
    for batch in (0, 1, 100):
        with added_meanwhile(engine, partition, truth, batch) as counts:
            start, seconds = time.perf_counter(), []
            with engine.connect() as connection:
                while time.perf_counter() - start < WRITING_SECONDS:
                    query = truth.drawn.queries[len(seconds) % QUERIES]
                    begin = time.perf_counter()
                    with connection.begin():
                        find_nearest(connection, partition, query, K)
                    seconds.append(time.perf_counter() - begin)
        milliseconds = np.array(seconds) * 1e3
        rows.append([
            f"{len(truth.drawn.vectors):,}", str(batch or "nobody adds"), f"{sum(counts) / WRITING_SECONDS:.0f}",
            f"{len(seconds) / WRITING_SECONDS:.0f}", f"{np.median(milliseconds):.1f}",
            f"{np.quantile(milliseconds, 0.99):.1f}",
        ])  # fmt: skip
        log(str(rows[-1]))
    return rows


@contextmanager
def added_meanwhile(engine: Engine, partition: Partition, truth: Truth, batch: int) -> Iterator[list[int]]:
    """Add shapes, `batch` in a transaction, until the block ends."""
    counts: list[int] = []
    stop = threading.Event()

    def add() -> None:
        while not stop.is_set():
            with engine.begin() as connection:
                first = connection.scalar(text("SELECT max(seq) + 1 FROM shapes"))
                last = first + batch - 1
                for statement in ROWS:
                    connection.execute(text(statement), values(first, last))
                connection.execute(
                    text(
                        "INSERT INTO shapes (seq, id, name, metadata, signature_id, created_at)"
                        " SELECT n, lpad(to_hex(n), 32, '0'), 'new', '{}', n, 0 FROM" + NUMBERS
                    ),
                    {"first": first, "last": last},
                )
                new = [
                    {"seq": seq, "partition_id": partition.id, "embedding": as_text(truth.drawn.queries[seq % QUERIES])}
                    for seq in range(first, last + 1)
                ]
                connection.execute(vectors.insert(), new)
            counts.append(batch)

    thread = threading.Thread(target=add)
    if batch:
        thread.start()
    try:
        yield counts
    finally:
        stop.set()
        if batch:
            thread.join()


def log(line: str) -> None:
    print(time.strftime("%H:%M:%S"), line, file=sys.stderr, flush=True)


def page(base: Real, found: list[dict[str, Any]]) -> str:
    scans = [
        [
            f"{each['size']:,}", f"{each['memory'] * 1e3:.1f}", *each["scan"][1:], *each["chosen"],
            f"{each['table']:.0f}",
        ]
        for each in found
    ]  # fmt: skip
    load = ", ".join("{:,}: {:.1f}".format(each["size"], each["load"]) for each in found)
    alike = ", ".join("{:,}: {:.1f} and {:.1f}".format(each["size"], *each["likeness"]) for each in found)
    return "\n\n".join(
        [
            f"PostgreSQL 18 with pgvector 0.8.5, {available_cores()} cores, shared_buffers {SETTINGS['shared_buffers']}, maintenance_work_mem {MEMORY_MB} MB, {QUERIES} queries, {len(base.labels)} real shapes. Median distance from a query to the nearest shape of its own class, and to the nearest of another class: {alike}. Mean number of programs that ran or waited, of these and of others, for the last five minutes: {load}; where it is above the number of cores, times are too long.",  # noqa: E501
            "**The chosen search**: an index of half precision with m = 16 and ef_construction = 64, ef_search = 100, and 100 candidates in exact order. Beside it, the exact scan of the index in memory, and the same scan by PostgreSQL (times of one query in ms; processor: mean time of the processor in client and server, which is the time of a query where nothing else runs).",  # noqa: E501
            table(["vectors", "memory", "PostgreSQL scan, median", "p99", "recall at 10", "median", "p99", "processor", "bytes a vector in the table"], scans),  # noqa: E501
            f"**Indexes**: recall at 10 in the order of the index, and after min(ef_search, {CANDIDATES}) candidates were ordered exactly (times in ms).",  # noqa: E501
            table(["vectors", "type", "m", "ef_construction", "build, s", "bytes a vector", "ef_search", "recall", "recall, ordered", "median", "p99"], [row for each in found for row in each["grid"]]),  # noqa: E501
            f"**Filters**: each way to search among the shapes that a filter keeps got {FILTERED} queries. The column found has the mean number of the ten shapes that were returned; times are in ms. The label is that of a class of 1 % of the shapes, and seldom that of the query.",  # noqa: E501
            table(["vectors", "filter", "keeps", "way", "found", "recall", "median", "p99"], [row for each in found for row in each["filters"]]),  # noqa: E501
            "**Classes**: how often the answer of the database equals that of the index in memory (times in ms). Samples: the vectors in memory from which the distances of far classes are estimated.",  # noqa: E501
            table(["vectors", "classes", "classifier", "candidates", "same label", "same `known`", "confidence within .01", "largest error", "median", "p99", "samples", "drawing them, s"], [row for each in found for row in each["classes"]]),  # noqa: E501
            "**Adding shapes meanwhile**: one connection adds shapes with their vectors, and another one searches (times of a query in ms).",  # noqa: E501
            table(["vectors", "shapes in a transaction", "added a second", "queries a second", "median", "p99"], [row for each in found for row in each["writing"]]),  # noqa: E501
        ]
    )  # fmt: skip


if __name__ == "__main__":
    main()
