"""Classes of a query by its nearest shapes in a database, and by samples of the classes that are farther."""

from __future__ import annotations

import threading
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from sqlalchemy import BindParameter, ColumnElement, Connection, Double, LargeBinary, bindparam, cast, func, select

from unbend.arrays import Floats, Singles
from unbend.errors import ParameterError
from unbend.library.search.nearest import CONDITIONS, EVERY, Filter, Nearest, find_nearest, values_of
from unbend.library.storage.schema import library_state, shapes
from unbend.library.vector_rows import Partition, VectorKind, as_text, from_bytes, vector_type, vectors
from unbend.matching.classification import SAMPLE, Classification, ClassSamples, classify
from unbend.matching.classification.calibration import calibration_of
from unbend.matching.gallery import Gallery

FROM_CANDIDATES: Final = frozenset({"nearest", "vote"})
"""The classifiers for which the nearest shapes suffice. The others need the vectors of all shapes."""

_CLASS_CANDIDATES: Final = 1000
"""Nearest labelled shapes that determine the order of classes: fewer leave more of the confidence to an estimate."""

_CLASS_MEMBERS: Final = 256
"""Nearest members of the best class that decide whether a query is known (see `calibration.is_known`)."""

_STALE_SHARE: Final = 0.05
"""Samples are drawn again after changes of more than this share of the shapes."""


def classify_nearest(
    connection: Connection,
    partition: Partition,
    query: Singles,
    samples: ClassSamples,
    classifier: str,
    only: Filter = EVERY,
    *,
    without: int = 0,
    exact: bool = False,
    candidates: int = _CLASS_CANDIDATES,
) -> Classification:
    """Classify a query by its nearest labelled shapes.

    The result has the classes of these shapes. The distances of the other classes, which lower the confidences, are
    estimated from samples. `known` depends on the nearest members of the best class, which are found exactly.

    Parameters
    ----------
    connection : Connection
    partition : Partition
    query : (d,) float32
    samples : ClassSamples
        Of the partition's classes.
    classifier : str
        One of FROM_CANDIDATES.
    only, without, exact
        As in `find_nearest`.
    candidates : int, default 1000
        Number of nearest labelled shapes that are compared.

    Raises
    ------
    ParameterError
        If the classifier needs all shapes.
    """
    if classifier not in FROM_CANDIDATES:
        raise ParameterError(f"{classifier} needs the vectors of all shapes, not only those of the nearest ones")
    measure, exponent = partition.kind.measure, calibration_of(partition.kind.measure.name).exponents[classifier]
    labelled = replace(only, is_labelled=True)
    near = find_nearest(connection, partition, query, candidates, labelled, without=without, exact=exact)
    first = classify(_gallery(near), measure, query, near.distances, classifier)
    if not first.matches or (near.is_exact and len(near.seqs) < candidates):
        return first  # no other shape has a label
    best = first.matches[0].label
    every = near
    if near.labels.count(best) < _CLASS_MEMBERS:
        in_best = replace(only, label=best)
        members = find_nearest(connection, partition, query, _CLASS_MEMBERS, in_best, without=without, exact=exact)
        every = _joined(near, members)
    present = {label for label in near.labels if label is not None}
    if near.is_exact:
        absent = _other_classes(connection, partition, query, labelled, without, present)
    else:
        absent = samples.absent(query, measure, present, float(near.distances[-1]), exponent)
    return classify(_gallery(every), measure, query, every.distances, classifier, absent)


def _other_classes(
    connection: Connection, partition: Partition, query: Singles, only: Filter, without: int, present: Collection[str]
) -> Floats:
    """Return the distances of the nearest members of all classes that are not present, by a scan."""
    sent: BindParameter[str] = bindparam("query")
    distance: ColumnElement[float] = vectors.c.embedding.op("<+>", return_type=Double())(
        cast(sent, vector_type("vector"))
    )
    each = (
        select(shapes.c.label, func.min(distance).label("distance"))
        .join(vectors, vectors.c.seq == shapes.c.seq)
        .where(partition.own, vectors.c.seq != bindparam("without"), *(CONDITIONS[name] for name in only.given))
        .group_by(shapes.c.label)
    )
    rows = connection.execute(each, {"query": as_text(query), "without": without, **values_of(only)}).all()
    return np.array([row.distance for row in rows if row.label not in present], float)


def _gallery(found: Nearest) -> Gallery:
    return Gallery.of(found.vectors, found.labels)


def _joined(one: Nearest, other: Nearest) -> Nearest:
    """Return the shapes of both, each once."""
    seqs, rows = np.unique(np.concatenate([one.seqs, other.seqs]), return_index=True)
    labels = (*one.labels, *other.labels)
    return Nearest(
        seqs, tuple(labels[row] for row in rows), np.concatenate([one.distances, other.distances])[rows],
        np.concatenate([one.vectors, other.vectors])[rows], one.is_exact and other.is_exact,
    )  # fmt: skip


@dataclass(frozen=True)
class _Drawn:
    epoch: str
    revision: int
    samples: ClassSamples

    def is_fresh(self, epoch: str, revision: int) -> bool:
        changes = revision - self.revision
        return epoch == self.epoch and 0 <= changes <= _STALE_SHARE * self.samples.sizes.sum()


class SampledClasses:
    """Samples of the classes of partitions, in memory. They are drawn again when many shapes changed. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._drawn: dict[VectorKind, _Drawn] = {}

    def of(self, connection: Connection, partition: Partition) -> ClassSamples:
        """Return the samples of a partition's classes, which may lack the last changes of a few shapes.

        While a thread draws new samples, which takes seconds in a large library, other threads use the earlier ones.
        """
        epoch, revision = connection.execute(select(library_state.c.epoch, library_state.c.revision)).one()
        drawn = self._drawn.get(partition.kind)
        if drawn and drawn.is_fresh(epoch, revision):
            return drawn.samples
        if not self._lock.acquire(blocking=drawn is None or drawn.epoch != epoch):
            assert drawn is not None  # noqa: S101  the lock was not waited for
            return drawn.samples
        try:
            drawn = self._drawn.get(partition.kind)
            if not drawn or not drawn.is_fresh(epoch, revision):
                drawn = _Drawn(epoch, revision, draw_samples(connection, partition))
                self._drawn[partition.kind] = drawn
            return drawn.samples
        finally:
            self._lock.release()


def draw_samples(connection: Connection, partition: Partition) -> ClassSamples:
    """Draw random members of each class of a partition; this reads the labels of all shapes."""
    # A hash instead of a random number: the samples of every process are the same.
    order = func.row_number().over(partition_by=shapes.c.label, order_by=func.hashint8(shapes.c.seq)).label("place")
    size = func.count().over(partition_by=shapes.c.label).label("size")
    listed = (
        select(shapes.c.seq, shapes.c.label, order, size)
        .join(vectors, vectors.c.seq == shapes.c.seq)
        .where(partition.own, shapes.c.label.is_not(None))
        .subquery()
    )
    sent = func.vector_send(vectors.c.embedding, type_=LargeBinary)
    chosen = (
        select(listed.c.label, listed.c.size, sent)
        .join(vectors, vectors.c.seq == listed.c.seq)
        .where(partition.own, listed.c.place <= SAMPLE)
        .order_by(listed.c.label, listed.c.place)
    )
    rows = connection.execute(chosen).all()
    if not rows:
        return ClassSamples((), np.empty(0, np.int64), np.empty((0, partition.dimensions), np.float32))
    labels, sizes, members = zip(*rows, strict=True)
    size_of = dict(zip(labels, sizes, strict=True))
    return ClassSamples(tuple(size_of), np.array(list(size_of.values())), from_bytes(members, partition.dimensions))
