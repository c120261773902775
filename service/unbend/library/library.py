"""The library of shapes: the one object that callers use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

from sqlalchemy import Connection

from unbend.errors import ParameterError
from unbend.library import shapes as rows
from unbend.library.backup import Backup, backup
from unbend.library.engine import Store
from unbend.library.export import export
from unbend.library.index import IndexKey, VectorIndex
from unbend.library.key import UploadKey
from unbend.library.overview import MAP_LIMIT, MapDistance, ShapeMap, Shown, evaluation_of, map_of, select
from unbend.library.payload import PackedSignature, unpack_signature
from unbend.library.ranking import Question, Ranking, rank
from unbend.library.records import ShapeMatch, ShapePage, ShapeRecord
from unbend.library.shapes import IfKnown
from unbend.library.values import check_changes
from unbend.matching.classification import DEFAULT_CLASSIFIER, ClassMatch
from unbend.matching.evaluate import Evaluation, RetrievalFigures
from unbend.matching.measures import DEFAULT_MEASURE, VectorMeasure, get_vector_measure
from unbend.matching.measures.moments import SURFACE_MOMENTS
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh as read_surface
from unbend.names import MAX_TEXT, printable
from unbend.signature.parameters import Parameters
from unbend.signature.pipeline import compute_signature
from unbend.signature.signature import ALGORITHM_VERSION, Signature

DEFAULT_K = 10


@dataclass(frozen=True)
class Received:
    """A shape that was given to a library."""

    shape: ShapeRecord
    is_new: bool
    """Whether it was not stored before."""
    ignored: Sequence[str] = ()
    """Fields given that differ from the stored ones and were not taken: of "name", "label", "metadata"."""
    updated: Sequence[str] = ()
    """Fields given that differed from the stored ones and were taken."""


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
        if_known: IfKnown = "keep",
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
            Anything that JSON can hold: at most 32 kB of it, 16 deep, with 1000 members.
        parameters : Parameters, optional
        policy : MeshPolicy, optional
            How the mesh is read. Shapes are compared whatever theirs is.
        if_known : "keep" or "update", default "keep"
            Whether a shape that was stored before from the same file, with the same parameters and policy, stays as it
            is, or takes the name, label and metadata that are given.

        Returns
        -------
        ShapeRecord
            The stored one if there is one. `receive` says whether that is so, and what it did not take.

        Raises
        ------
        MeshError
            As `read_mesh` and `compute_signature` do.
        ParameterError
            If the name, label or metadata cannot be stored.
        """
        given = {"name": name, "label": label, "metadata": metadata}
        return self.receive(source, given, parameters=parameters, policy=policy, if_known=if_known).shape

    def receive(
        self,
        source: bytes | str | Path,
        given: Mapping[str, Any],
        *,
        parameters: Parameters | None = None,
        policy: MeshPolicy | None = None,
        if_known: IfKnown = "keep",
    ) -> Received:
        """Do as `add` does, and say what became of it.

        `given` holds the name, label and metadata; those that are None are not given.
        """
        path = Path("unnamed") if isinstance(source, bytes) else Path(source)
        sent = {name: value for name, value in given.items() if value is not None}
        described: dict[str, Any] = {"name": printable(path.stem)[:MAX_TEXT], "label": None, "metadata": {}} | sent
        check_changes(described)
        data = source if isinstance(source, bytes) else path.read_bytes()
        chosen, reading = parameters or Parameters(), policy or MeshPolicy()
        key = UploadKey.of(data, chosen, reading)
        with self.store.read() as connection:
            known = rows.find_shape(connection, key)
        if known:
            told = self.store.change(partial(rows.describe_anew, record=known, sent=sent, if_known=if_known))
            return Received(told.shape, is_new=False, ignored=told.ignored, updated=told.updated)
        surface = read_surface(data, file_type=path.suffix, policy=reading)
        new = rows.NewShape(
            sha256=key.sha256,
            policy=reading,
            signature=PackedSignature.of(compute_signature(surface, chosen)),
            area=surface.area,
            report=surface.report.as_dict(),
            **described,
        )

        def store(connection: Connection) -> ShapeRecord:
            rows.put_mesh(connection, key.sha256, data)
            return rows.get_shape(connection, rows.add_shape(connection, new))

        return Received(self.store.change(store), is_new=True)

    def get(self, shape_id: str) -> ShapeRecord:
        """Return a shape's record; NotFoundError if there is none."""
        with self.store.read() as connection:
            return rows.get_shape(connection, shape_id)

    def page(
        self, *, label: str | None = None, sha256: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> ShapePage:
        """Return up to `limit` (at most 500) shapes after `cursor`, in the order they were added.

        Only those of a class, or made from the file with a hash, where that is given.
        """
        if limit < 1:
            raise ParameterError(f"limit must be at least 1, not {limit}")
        with self.store.read() as connection:
            return rows.list_shapes(connection, label=label, sha256=sha256, cursor=cursor, limit=limit)

    def change(self, shape_id: str, changes: dict[str, Any]) -> ShapeRecord:
        """Set some of a shape's name, label and metadata."""
        check_changes(changes)
        return self.store.change(partial(rows.change_shape, shape_id=shape_id, changes=changes))

    def remove(self, shape_id: str) -> None:
        """Remove a shape and everything stored of it."""
        self.store.change(partial(rows.remove_shape, shape_id=shape_id))

    def mesh(self, shape_id: str) -> bytes:
        """Return the file a shape was made from, byte for byte."""
        with self.store.read() as connection:
            return rows.get_mesh(connection, rows.get_shape(connection, shape_id).sha256)

    def read_mesh(self, sha256: str, offset: int, size: int) -> bytes:
        """Return some bytes of a stored file, at most `size` from `offset`; NotFoundError if it is not there."""
        with self.store.read() as connection:
            return rows.read_mesh_piece(connection, sha256, offset, size)

    def signature(self, shape_id: str) -> Signature:
        """Return a shape's signature."""
        with self.store.read() as connection:
            return unpack_signature(rows.get_signature_payload(connection, shape_id))

    def labels(self) -> dict[str, int]:
        """Return the classes and how many shapes each has."""
        with self.store.read() as connection:
            return rows.count_labels(connection)

    def backup(self, destination: str | Path, *, overwrite: bool = False) -> Backup:
        """Copy the library into one file while it is used; `unbend restore` puts it back.

        Raises
        ------
        ParameterError
            If the library is no SQLite file, or the destination is taken and not to be overwritten.
        StoreError
            If it cannot be copied; BackupError if it is damaged.
        """
        return backup(self.store.url, destination, overwrite=overwrite)

    def export(self, folder: str | Path) -> int:
        """Write every shape's file, and labels.csv, to a folder that is empty or will be made; return how many.

        Raises
        ------
        ParameterError
            If the folder is not empty.
        """
        return export(self.store, folder)

    def __len__(self) -> int:
        with self.store.read() as connection:
            return rows.count_shapes(connection)

    def rank(
        self,
        query: Signature | str,
        *,
        measure: str = DEFAULT_MEASURE,
        classifier: str = DEFAULT_CLASSIFIER,
        k: int = DEFAULT_K,
    ) -> Ranking:
        """Rank classes and the `k` nearest shapes.

        Parameters
        ----------
        query : Signature or str
            A signature, or the id of a stored shape, which is then not among its own answers.
        measure : str
            One that compares whole shapes (`rigid`, `hausdorff`, `max_hausdorff`, `reeb`) puts those in order that are
            nearest by the default measure; classes are then the default measure's.
        classifier : str
            How distances from shapes become those from classes.
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
            If there is no such measure or classifier, `k` is below 1, or above `MOST_PAIRS` where whole shapes are
            compared; UnsuitedError if the classifier needs more labels.
        """
        return rank(self.store, self._index, query, Question.of(measure, classifier, k))

    def nearest(
        self, query: Signature | str, k: int = DEFAULT_K, *, measure: str = DEFAULT_MEASURE
    ) -> Sequence[ShapeMatch]:
        """Return the `k` nearest shapes, as `rank` finds them."""
        return self.rank(query, measure=measure, k=k).shapes

    def classify(
        self, query: Signature | str, *, measure: str = DEFAULT_MEASURE, classifier: str = DEFAULT_CLASSIFIER
    ) -> Sequence[ClassMatch]:
        """Return the classes, the most likely first, as `rank` finds them."""
        return self.rank(query, measure=measure, classifier=classifier, k=1).classes

    def evaluate(self, measure: str = DEFAULT_MEASURE, *, parameters: Parameters | None = None) -> RetrievalFigures:
        """Return the figures of `evaluation`, which is asked with the same."""
        return cast("RetrievalFigures", self.evaluation(measure, parameters=parameters).figures)

    def evaluation(self, measure: str = DEFAULT_MEASURE, *, parameters: Parameters | None = None) -> Evaluation:
        """Ask the labelled shapes made with `parameters` of each other: figures, per class too, and confusions.

        Of a very large library some shapes, evenly chosen, are asked of all others.

        Raises
        ------
        ParameterError
            If there is no such measure, or it does not compare vectors; UnsuitedError if no class has two members.
        """
        chosen = get_vector_measure(measure)
        with self.store.read() as connection:
            held = self._index.get(connection, _key(chosen, parameters))
        return evaluation_of(held, chosen)

    def map(
        self,
        measure: str = DEFAULT_MEASURE,
        *,
        parameters: Parameters | None = None,
        dimensions: int = 2,
        limit: int = MAP_LIMIT,
        distance: MapDistance = "l1",
    ) -> ShapeMap:
        """Place the shapes made with `parameters` so that those alike are near each other (the paper's Fig. 8).

        Parameters
        ----------
        measure : str
        parameters : Parameters, optional
            Defaults as `Parameters()` has them.
        dimensions : int, default 2
        limit : int, default 5000
            Of more shapes, evenly chosen ones are shown.
        distance : {"l1", "squared_l2"}
            What the map shows: sums of absolute differences, by which shapes are compared, or of squared ones, which
            the paper's D_M has (section 2.3).

        Raises
        ------
        ParameterError
            If there is no such measure, or it does not compare vectors, or a number is below 1, or there is no such
            distance.
        """
        chosen, shown = get_vector_measure(measure), Shown(dimensions, limit, distance)
        with self.store.read() as connection:
            held, original = (self._index.get(connection, _key(each, parameters)) for each in (chosen, SURFACE_MOMENTS))
            selection = select(connection, held, original, shown.limit)
        return map_of(selection, chosen, shown)


def _key(measure: VectorMeasure, parameters: Parameters | None) -> IndexKey:
    return IndexKey(measure, (parameters or Parameters()).to_json(), ALGORITHM_VERSION)
