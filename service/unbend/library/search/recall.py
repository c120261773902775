"""The recall of the approximate index: how many of the nearest shapes it finds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from sqlalchemy import Connection, func, select

from unbend.library import shape_rows
from unbend.library.search.nearest import find_nearest
from unbend.library.vector_rows import Partition, vectors

COUNT: Final = 10
"""Nearest shapes of each query that are compared."""

QUERIES: Final = 100
"""Stored shapes that are queries."""


def measure_recall(connection: Connection, partition: Partition, queries: int = QUERIES) -> float:
    """Return the mean share of the ten nearest shapes that the index finds, for stored shapes as queries.

    A search without the index has the recall 1.
    """
    chosen = select(vectors.c.seq).where(partition.own).order_by(func.hashint8(vectors.c.seq)).limit(queries)
    return float(np.mean([_recall(connection, partition, seq) for seq in connection.scalars(chosen).all()] or [1.0]))


def _recall(connection: Connection, partition: Partition, seq: int) -> float:
    vector = partition.kind.measure.vector(shape_rows.get_descriptors(connection, seq))
    found, true = (
        find_nearest(connection, partition, vector, COUNT, without=seq, exact=exact) for exact in (False, True)
    )
    return _share(found.seqs.tolist(), true.seqs.tolist())


def _share(found: Sequence[int], true: Sequence[int]) -> float:
    return len(set(found) & set(true)) / len(true) if true else 1.0
