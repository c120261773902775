"""The library of shapes: the one object that callers use."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from unbend.errors import NotFoundError, ParameterError
from unbend.library import shapes as rows
from unbend.library.engine import Store
from unbend.library.index import IndexedShapes, IndexKey, VectorIndex
from unbend.library.key import UploadKey
from unbend.library.payload import unpack_signature
from unbend.library.records import ShapeMatch, ShapePage, ShapeRecord
from unbend.library.values import MAX_TEXT, check_changes
from unbend.matching.evaluate import RetrievalFigures, leave_one_out
from unbend.matching.gallery import Gallery
from unbend.matching.measures import DEFAULT_MEASURE, get_vector_measure
from unbend.matching.ranking import ClassMatch, is_known, rank_classes, rank_shapes
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh
from unbend.signature.parameters import Parameters
from unbend.signature.pipeline import compute_signature
from unbend.signature.signature import ALGORITHM_VERSION, Signature

DEFAULT_K = 10


@dataclass(frozen=True)
class Ranking:
    """What a query is and what is like it, best first."""

    measure: str
    classes: list[ClassMatch]
    shapes: list[ShapeMatch]
    known: bool | None
    """Whether the nearest class is near enough; None where the library cannot tell."""

    def as_dict(self) -> dict[str, Any]:
        """Return the ranking as plain JSON values, as the HTTP contract has it."""
        return asdict(self)


class Library:
    """A store of shapes, their signatures and what can be asked of them; thread-safe.

    Parameters
    ----------
    url : str, default "unbend.db"
        A path of an SQLite file, made if it is not there, or an SQLAlchemy URL.

    Raises
    ------
    StoreError
        If the store cannot be opened; StoreVersionError if a later version made it.

    Examples
    --------
    >>> with Library("shapes.db") as library:                   # doctest: +SKIP
    ...     library.add("cat.off", label="cat")
    ...     library.classify(compute_signature(read_mesh("unknown.ply")))
    """

    def __init__(self, url: str = "unbend.db", *, migrate: bool = True) -> None:
        self.store = Store(url, migrate=migrate)
        self._index = VectorIndex()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the store."""
        self.store.close()

    def add(
        self,
        source: bytes | str | Path,
        *,
        name: str | None = None,
        label: str | None = None,
        metadata: dict[str, Any] | None = None,
        parameters: Parameters | None = None,
        policy: MeshPolicy | None = None,
    ) -> ShapeRecord:
        """Read a mesh, compute its signature and store both.

        Parameters
        ----------
        source : bytes, str or Path
            A mesh file's bytes or path.
        name : str, optional
            The path's stem by default, or "unnamed".
        label : str, optional
            The class that the shape is known to belong to.
        metadata : dict, optional
            Anything that JSON can hold.
        parameters : Parameters, optional
        policy : MeshPolicy, optional
            How the mesh is read. Shapes are compared whatever theirs is.

        Returns
        -------
        ShapeRecord
            The stored one if the same file was added with the same parameters and policy before.

        Raises
        ------
        MeshError
            As `read_mesh` and `compute_signature` do.
        ParameterError
            If the name, label or metadata cannot be stored.
        """
        given = Path("unnamed") if isinstance(source, bytes) else Path(source)
        described: dict[str, Any] = {
            "name": (name or given.stem)[:MAX_TEXT],
            "label": label,
            "metadata": metadata or {},
        }
        check_changes(described)
        data = source if isinstance(source, bytes) else given.read_bytes()
        chosen, reading = parameters or Parameters(), policy or MeshPolicy()
        key = UploadKey.of(data, chosen, reading)
        with self.store.read() as connection:
            known = rows.find_shape(connection, key)
        if known:
            return known
        surface = read_mesh(data, file_type=given.suffix, policy=reading)
        new = rows.NewShape(
            sha256=key.sha256,
            policy=reading,
            signature=compute_signature(surface, chosen),
            area=surface.area,
            report=surface.report.as_dict(),
            **described,
        )
        with self.store.write() as connection:
            rows.put_mesh(connection, key.sha256, data)
            return rows.add_shape(connection, new)

    def get(self, shape_id: str) -> ShapeRecord:
        """Return a shape's record; NotFoundError if there is none."""
        with self.store.read() as connection:
            return rows.get_shape(connection, shape_id)

    def page(self, *, label: str | None = None, cursor: str | None = None, limit: int = 100) -> ShapePage:
        """Return up to `limit` (at most 500) shapes after `cursor`, in the order they were added."""
        if limit < 1:
            raise ParameterError(f"limit must be at least 1, not {limit}")
        with self.store.read() as connection:
            return rows.list_shapes(connection, label=label, cursor=cursor, limit=limit)

    def change(self, shape_id: str, changes: dict[str, Any]) -> ShapeRecord:
        """Set some of a shape's name, label and metadata."""
        check_changes(changes)
        with self.store.write() as connection:
            return rows.change_shape(connection, shape_id, changes)

    def remove(self, shape_id: str) -> None:
        """Remove a shape and everything stored of it."""
        with self.store.write() as connection:
            rows.remove_shape(connection, shape_id)

    def mesh(self, shape_id: str) -> bytes:
        """Return the file a shape was made from, byte for byte."""
        with self.store.read() as connection:
            return rows.get_mesh(connection, rows.get_shape(connection, shape_id).sha256)

    def signature(self, shape_id: str) -> Signature:
        """Return a shape's signature."""
        with self.store.read() as connection:
            return unpack_signature(rows.get_signature_payload(connection, shape_id))

    def labels(self) -> dict[str, int]:
        """Return the classes and how many shapes each has."""
        with self.store.read() as connection:
            return rows.count_labels(connection)

    def __len__(self) -> int:
        with self.store.read() as connection:
            return rows.count_shapes(connection)

    def rank(self, query: Signature | str, *, measure: str = DEFAULT_MEASURE, k: int = DEFAULT_K) -> Ranking:
        """Rank classes and the `k` nearest shapes.

        Parameters
        ----------
        query : Signature or str
            A signature, or the id of a stored shape, which is then not among its own answers.
        measure : str
        k : int
            Shapes returned; all classes are.

        Returns
        -------
        Ranking
            Only shapes whose signatures were made with the query's parameters take part.

        Raises
        ------
        NotFoundError
            If there is no such shape.
        ParameterError
            If there is no such measure, or `k` is below 1.
        """
        if k < 1:
            raise ParameterError(f"k must be at least 1, not {k}")
        chosen = get_vector_measure(measure)
        signature = self.signature(query) if isinstance(query, str) else query
        held = self._held(IndexKey(measure, signature.parameters.to_json(), signature.version))
        if isinstance(query, str):
            held = _without(held, query)
        if not held.ids:
            return Ranking(measure, [], [], None)
        distances = chosen.distances(chosen.vector(signature.descriptors), held.vectors)
        gallery = Gallery.of(held.vectors, held.labels)
        classes = rank_classes(distances, gallery)
        matches = [
            ShapeMatch(held.ids[row], held.names[row], held.labels[row], float(distances[row]))
            for row in rank_shapes(distances, k)
        ]
        return Ranking(measure, classes, matches, is_known(gallery, chosen, classes[0] if classes else None))

    def nearest(
        self, query: Signature | str, k: int = DEFAULT_K, *, measure: str = DEFAULT_MEASURE
    ) -> list[ShapeMatch]:
        """Return the `k` nearest shapes, as `rank` finds them."""
        return self.rank(query, measure=measure, k=k).shapes

    def classify(self, query: Signature | str, *, measure: str = DEFAULT_MEASURE) -> list[ClassMatch]:
        """Return the classes, nearest first, as `rank` finds them."""
        return self.rank(query, measure=measure, k=1).classes

    def evaluate(self, measure: str = DEFAULT_MEASURE, *, parameters: Parameters | None = None) -> RetrievalFigures:
        """Return leave-one-out retrieval figures of the labelled shapes made with `parameters`.

        Raises
        ------
        ParameterError
            If no class has two members, or there is no such measure.
        """
        chosen = get_vector_measure(measure)
        held = self._held(IndexKey(measure, (parameters or Parameters()).to_json(), ALGORITHM_VERSION))
        labelled = [row for row, label in enumerate(held.labels) if label is not None]
        return leave_one_out(
            chosen.matrix(held.vectors[labelled]) if labelled else np.empty((0, 0)),
            [str(held.labels[row]) for row in labelled],
        )

    def _held(self, key: IndexKey) -> IndexedShapes:
        with self.store.read() as connection:
            return self._index.get(connection, key)


def _without(held: IndexedShapes, shape_id: str) -> IndexedShapes:
    rest = [row for row, other in enumerate(held.ids) if other != shape_id]
    if len(rest) == len(held.ids):
        raise NotFoundError(f"no shape {shape_id}")
    return IndexedShapes(
        held.vectors[rest],
        tuple(held.ids[row] for row in rest),
        tuple(held.names[row] for row in rest),
        tuple(held.labels[row] for row in rest),
        held.revision,
        held.last_seq,
    )
