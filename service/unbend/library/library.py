"""The library of shapes: the object that Python callers use."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

from unbend.library.backups.backup import Backup, backup
from unbend.library.backups.export import export
from unbend.library.jobs import Jobs
from unbend.library.keys import Keys
from unbend.library.packing import pack_local
from unbend.library.records import Received, ShapeMatch, ShapePage, ShapeRecord
from unbend.library.requests import DEFAULT_K, IfKnown, QueryRequest, ShapeRequest, Upload
from unbend.library.search import MapOptions, Ranking, Search, ShapeMap
from unbend.library.search.overview import MAP_LIMIT, MapDistance
from unbend.library.shape_rows import ComputedShape
from unbend.library.shapes import Shapes
from unbend.library.storage.disk import LibraryDisk
from unbend.library.storage.store import Store
from unbend.local.signatures import local_signatures
from unbend.matching.classification import DEFAULT_CLASSIFIER, ClassMatch
from unbend.matching.evaluate import Evaluation, RetrievalMetrics
from unbend.matching.measures import DEFAULT_MEASURE
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh
from unbend.mesh.sources import MeshSource, bytes_of
from unbend.names import DEFAULT_LIBRARY, shape_name
from unbend.signature.from_file import signature_of_file
from unbend.signature.parameters import Parameters
from unbend.signature.signature import Signature


class Library:
    """A library of shapes; thread-safe.

    Its methods serve programs that compute in their own process. Servers use its parts: `shapes`, `jobs`, `keys`,
    `search` and `disk`.

    Parameters
    ----------
    url : str, default "unbend.db"
        A path of an SQLite file, which is created if it is missing, or an SQLAlchemy URL.
    migrate : bool, default True
        Migrate the database to the present schema first.

    Raises
    ------
    StoreError
        If the database cannot be opened; StoreVersionError if a later version of unbend made it.

    Examples
    --------
    >>> with Library("shapes.db") as library:                   # doctest: +SKIP
    ...     library.add("cat.off", label="cat")
    ...     library.classify(compute_signature(read_mesh("unknown.ply")))
    """

    def __init__(self, url: str = DEFAULT_LIBRARY, *, migrate: bool = True) -> None:
        self.store = Store(url, migrate=migrate)
        self.shapes = Shapes(self.store)
        self.jobs = Jobs(self.store)
        self.keys = Keys(self.store)
        self.search = Search(self.store)

    @property
    def url(self) -> str:
        """The address that the library was opened with."""
        return self.store.url

    @property
    def disk(self) -> LibraryDisk | None:
        """The disk of an SQLite file; None for other databases."""
        return self.store.disk

    def check_writable(self, size: int = 0) -> None:
        """Check that the library can store an upload of `size` bytes.

        Raises
        ------
        StoreLostError
            If its file was removed or replaced.
        StoreFullError
            If its disk has no space.
        """
        self.store.check()
        if self.disk:
            self.disk.admit_upload(size)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Run the queued changes, and close the database."""
        self.store.close()

    def add(
        self,
        source: MeshSource,
        *,
        name: str | None = None,
        label: str | None = None,
        metadata: dict[str, Any] | None = None,
        parameters: Parameters | Mapping[str, Any] | None = None,
        policy: MeshPolicy | Mapping[str, Any] | None = None,
        if_known: IfKnown = "keep",
    ) -> ShapeRecord:
        """Read a mesh, compute its signature and store both.

        Parameters
        ----------
        source : bytes, str, Path, binary file, Surface, pair of arrays, or mesh object
            A mesh, as `read_mesh` takes it. The library keeps the file; of a mesh in memory, it keeps a ply file of
            double precision.
        name : str, optional
            By default the stem of the file's name, or "unnamed".
        label : str, optional
            The known class of the shape.
        metadata : dict, optional
            JSON values: at most 32 kB, 16 levels and 1000 members.
        parameters : Parameters or mapping, optional
        policy : MeshPolicy or mapping, optional
            How to read the mesh. Searches compare shapes that were read with different policies.
        if_known : {"keep", "update"}
            Whether a shape that is stored already, from the same file with the same parameters and policy, keeps its
            name, label and metadata, or takes the new ones.

        Returns
        -------
        ShapeRecord
            The new shape, or the stored one. `receive` also returns whether the shape is new, and which fields a
            stored shape did not take.

        Raises
        ------
        MeshError
            As by `read_mesh` and `compute_signature`.
        ParameterError
            If the name, label or metadata cannot be stored.
        """
        given = {"name": name, "label": label, "metadata": metadata}
        return self.receive(source, given, parameters=parameters, policy=policy, if_known=if_known).shape

    def receive(
        self,
        source: MeshSource,
        given: Mapping[str, Any],
        *,
        parameters: Parameters | Mapping[str, Any] | None = None,
        policy: MeshPolicy | Mapping[str, Any] | None = None,
        if_known: IfKnown = "keep",
    ) -> Received:
        """Add a mesh as `add` does, and return the outcome.

        `given` contains the name, label and metadata; None means not given.
        """
        file = bytes_of(source)
        request = ShapeRequest.of(shape_name(file.name), given, if_known)
        upload = Upload(file.data, file.file_type, Parameters.of(parameters), MeshPolicy.of(policy))
        if known := self.shapes.find(upload.key):
            return Received(**vars(self.shapes.update_known(known, request)))
        found = signature_of_file(file.data, upload.parameters, upload.policy, file_type=file.file_type, local=True)
        return self.shapes.receive(ComputedShape.of(upload.key, found), request, lambda: upload.data).result()

    def get(self, shape_id: str) -> ShapeRecord:
        """Return a shape; NotFoundError if there is none of this id."""
        return self.shapes.get(shape_id)

    def page(
        self, *, label: str | None = None, sha256: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> ShapePage:
        """Return up to `limit` shapes after `cursor`, in the order of adding; see `Shapes.page`."""
        return self.shapes.page(label=label, sha256=sha256, cursor=cursor, limit=limit)

    def change(self, shape_id: str, changes: Mapping[str, Any]) -> ShapeRecord:
        """Set some of a shape's name, label and metadata, and return it."""
        return self.shapes.change(shape_id, changes)

    def complete(self) -> Iterator[ShapeRecord]:
        """Compute the local signatures of shapes that earlier versions stored, and yield each shape.

        Raises
        ------
        MeshError
            If a stored mesh can no longer be read.
        """
        for shape in self.shapes.without_local():
            data = self.shapes.file(shape.sha256)
            surface = read_mesh(data, file_type=shape.file_type, policy=shape.policy)
            self.shapes.set_local(shape.id, pack_local(local_signatures(surface)))
            yield shape

    def remove(self, shape_id: str) -> None:
        """Remove a shape, its signature, descriptors and file."""
        self.shapes.remove(shape_id)

    def mesh(self, shape_id: str) -> bytes:
        """Return the file that a shape was made from, byte for byte."""
        return self.shapes.file(self.shapes.get(shape_id).sha256)

    def signature(self, shape_id: str) -> Signature:
        """Return a shape's signature."""
        return self.shapes.signature(shape_id)

    def labels(self) -> dict[str, int]:
        """Return the number of shapes of each class."""
        return self.shapes.labels()

    def __len__(self) -> int:
        return len(self.shapes)

    def backup(self, destination: str | Path, *, overwrite: bool = False) -> Backup:
        """Copy the library into one file while others use it; `unbend restore` restores it.

        Raises
        ------
        ParameterError
            If the library is not an SQLite file, or the destination exists and `overwrite` is False.
        StoreError
            If it cannot be copied; BackupError if it is damaged.
        """
        return backup(self.url, destination, overwrite=overwrite)

    def export(self, folder: str | Path) -> int:
        """Write the file of every shape, and labels.csv, to an empty or new folder; return the number of shapes.

        Raises
        ------
        ParameterError
            If the folder is not empty.
        """
        return export(self.store, folder)

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
            A signature, or the id of a stored shape, which is then not among the results.
        measure : str
            A measure of whole shapes (`rigid`, `hausdorff`, `max_hausdorff`, `reeb`) reorders the shapes that are
            nearest by the default measure. Classes are then ranked by the default measure. A measure of parts
            (`partial`, `partial_any_scale`) ranks wholes for a piece and pieces for a whole; a signature needs
            `compute_signature(..., local=True)` for it.
        classifier : str
            The rule that turns distances from shapes into distances from classes.
        k : int
            Number of shapes to return; all classes are returned.

        Returns
        -------
        Ranking
            Only shapes whose signatures were computed with the query's parameters take part.

        Raises
        ------
        NotFoundError
            If there is no such shape.
        ParameterError
            If there is no such measure or classifier, `k` is below 1, or above `MAX_PAIRS` for a measure of
            whole shapes; UnsuitedError if the classifier needs more labels.
        """
        return self.search.rank(query, QueryRequest(measure, classifier, k))

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

    def evaluate(self, measure: str = DEFAULT_MEASURE, *, parameters: Parameters | None = None) -> RetrievalMetrics:
        """Return the retrieval metrics of `evaluation`."""
        return cast("RetrievalMetrics", self.evaluation(measure, parameters=parameters).metrics)

    def evaluation(self, measure: str = DEFAULT_MEASURE, *, parameters: Parameters | None = None) -> Evaluation:
        """Evaluate retrieval among the labelled shapes computed with `parameters`, overall and by class.

        In a very large library, only some of the shapes are queries, chosen evenly.

        Raises
        ------
        ParameterError
            If there is no such measure, or it does not compare vectors; UnsuitedError if no class has two members.
        """
        return self.search.evaluation(measure, parameters)

    def map(
        self,
        measure: str = DEFAULT_MEASURE,
        *,
        parameters: Parameters | None = None,
        dimensions: int = 2,
        limit: int = MAP_LIMIT,
        distance: MapDistance = "l1",
    ) -> ShapeMap:
        """Embed the shapes computed with `parameters` so that similar shapes are near each other (the paper's Fig. 8).

        Parameters
        ----------
        measure : str
        parameters : Parameters, optional
            `Parameters()` by default.
        dimensions : int, default 2
        limit : int, default 5000
            Most shapes on the map. Of more shapes, it shows a selection, chosen evenly.
        distance : {"l1", "squared_l2"}
            Distance of descriptors: the sum of absolute differences, which searches use, or of squared differences, as
            in the paper's D_M (section 2.3).

        Raises
        ------
        ParameterError
            If there is no such measure, or it does not compare vectors, or a number is below 1, or there is no such
            distance.
        """
        return self.search.map(measure, parameters, MapOptions(dimensions, limit, distance))
