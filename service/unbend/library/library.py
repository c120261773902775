"""The library of shapes: the object that Python callers use."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast, get_args

from unbend.brief import brief, counted
from unbend.correspondence.match import Turn, match
from unbend.correspondence.pieces import Part
from unbend.errors import NotFoundError, ParameterError, ResultsError, UnbendError, check_choice
from unbend.library.address import LibraryAddress
from unbend.library.backups.backup import Backup, backup
from unbend.library.backups.export import export
from unbend.library.computed import check_computed
from unbend.library.jobs import JobFilter, Jobs
from unbend.library.keys import Keys
from unbend.library.mesh_files import MeshFiles
from unbend.library.metadata import Scalar
from unbend.library.packing import pack_local
from unbend.library.requests import QueryRequest, ShapeRequest, Upload
from unbend.library.search import MapOptions, Search, SearchChoice
from unbend.library.search.overview import MAP_LIMIT
from unbend.library.shape_rows import MAX_PAGE, ComputedShape
from unbend.library.shapes import Shapes
from unbend.library.storage.database import shown_url
from unbend.library.storage.disk import LibraryDisk
from unbend.library.storage.store import Store
from unbend.local.signatures import local_signatures
from unbend.matching.classification import DEFAULT_CLASSIFIER, ClassMatch
from unbend.matching.evaluate import RetrievalMetrics
from unbend.matching.measures import DEFAULT_MEASURE
from unbend.mesh.policy import MeshPolicy, PolicyLike
from unbend.mesh.read import read_mesh
from unbend.mesh.sources import MeshSource, bytes_of
from unbend.mesh.surface import Surface
from unbend.names import DEFAULT_LIBRARY, shape_name
from unbend.results.evaluations import EvaluationResult
from unbend.results.jobs import JobKind, JobState, JobStatus
from unbend.results.maps import MapDistance, ShapeMap
from unbend.results.points import PointMap
from unbend.results.rankings import DEFAULT_K, Ranking, ShapeMatch, shape_id_of
from unbend.results.shapes import AddedShape, IfKnown, ShapeOrder, ShapePage, ShapeRecord
from unbend.signature.from_file import signature_of_file
from unbend.signature.parameters import Parameters, ParametersLike
from unbend.signature.signature import Signature


class Library:
    """A library of shapes; thread-safe.

    `Client` has the same methods, with the same results, for a library behind a service. Servers use the parts of this
    object: `shapes`, `jobs`, `keys`, `search` and `disk`.

    Parameters
    ----------
    url : str, default "unbend.db"
        A path of an SQLite file, which is created if it is missing, or an SQLAlchemy URL.
    migrate : bool, default True
        Migrate the database to the present schema first.
    search : {"auto", "memory", "database"}
        Who searches: an index in memory, or PostgreSQL with pgvector. By default the index in memory, until it becomes
        too large.
    objects : str, optional
        The address of an object store, where the files of new meshes are then kept, and not in the database: such as
        s3://bucket/prefix, gs://bucket/prefix, az://account/container/prefix or file:///folder. The environment has
        the credentials.

    Raises
    ------
    StoreError
        If the database cannot be opened; StoreVersionError if a later version of unbend made it.

    Examples
    --------
    >>> with Library("shapes.db") as library:                   # doctest: +SKIP
    ...     library.add("cat.off", label="cat")
    ...     library.classify("unknown.ply")[0].label
    """

    def __init__(
        self,
        url: str = DEFAULT_LIBRARY,
        *,
        migrate: bool = True,
        search: SearchChoice = "auto",
        objects: str | None = None,
    ) -> None:
        self.store = Store(url, migrate=migrate, objects=objects)
        self.files = MeshFiles(self.store)
        self.shapes = Shapes(self.store, self.files)
        self.jobs = Jobs(self.store, self.files)
        self.keys = Keys(self.store)
        self.search = Search(self.store, search)

    @property
    def url(self) -> str:
        """The address that the library was opened with."""
        return self.store.url

    @property
    def address(self) -> LibraryAddress:
        """The addresses of the database and the object store, by which other processes open the same library."""
        return LibraryAddress(self.url, self.store.objects.url if self.store.objects else None)

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
            self.disk.admit_upload(size if self.files.are_in_database else 0)

    def __repr__(self) -> str:
        try:
            classes = self.labels()
            facts = counted(len(self), "shape"), counted(len(classes), "class", "classes")
        except UnbendError:  # a `repr` must not fail
            facts = ("closed" if self.store.is_closed else "not readable", "")
        return brief(self, repr(shown_url(self.url)), *facts)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Run the queued changes, and close the database."""
        self.files.close()
        self.store.close()

    def add(
        self,
        source: MeshSource,
        *,
        name: str | None = None,
        label: str | None = None,
        metadata: dict[str, Any] | None = None,
        parameters: ParametersLike = None,
        policy: PolicyLike = None,
        if_known: IfKnown = "keep",
    ) -> AddedShape:
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
        AddedShape
            The new shape, or the stored one: `is_new` says which, and `ignored` which fields a stored shape did not
            take.

        Raises
        ------
        MeshError
            As by `read_mesh` and `compute_signature`.
        ParameterError
            If the name, label or metadata cannot be stored.
        """
        file = bytes_of(source)
        given = {"name": name, "label": label, "metadata": metadata}
        request = ShapeRequest.of(shape_name(file.name), given, if_known)
        upload = Upload(file.data, file.file_type, Parameters.of(parameters), MeshPolicy.of(policy))
        if known := self.shapes.find(upload.key):
            return self.shapes.update_known(known, request)
        found = signature_of_file(file.data, upload.parameters, upload.policy, file_type=file.file_type, local=True)
        return self.shapes.submit(ComputedShape.of(upload.key, found), request, upload.open).result()

    def add_computed(
        self,
        source: MeshSource,
        computed: ComputedShape,
        *,
        name: str | None = None,
        label: str | None = None,
        metadata: dict[str, Any] | None = None,
        if_known: IfKnown = "keep",
    ) -> AddedShape:
        """Store a mesh and what `unbend.compute_file` has computed of it in another process, without computing.

        Every value is checked as if a stranger had made it. Only a computation could show that a signature belongs to
        its surface, so take results only from processes that you trust.

        Parameters
        ----------
        source : bytes, str, Path, binary file, Surface, pair of arrays, or mesh object
            The mesh, as `compute_file` got it.
        computed : ComputedShape
            The result of `compute_file`.
        name, label, metadata, if_known : optional
            As for `add`.

        Returns
        -------
        AddedShape
            As `add` returns it.

        Raises
        ------
        ResultsError
            If the results are those of another mesh or of another version of the algorithm, or are invalid.
        MeshFileError
            If the file of the mesh cannot be opened.
        ParameterError
            If the name, label or metadata cannot be stored.
        """
        file = bytes_of(source)
        request = ShapeRequest.of(shape_name(file.name), {"name": name, "label": label, "metadata": metadata}, if_known)
        if hashlib.sha256(file.data).hexdigest() != computed.key.sha256:
            raise ResultsError("the results are those of another mesh").with_advice(
                "Give add_computed the mesh that compute_file got."
            )
        check_computed(computed)
        return self.shapes.submit(computed, request, lambda: file.data).result()

    def get(self, shape_id: str) -> ShapeRecord:
        """Return a shape; NotFoundError if there is none of this id."""
        return self.shapes.get(shape_id)

    def page(
        self,
        *,
        label: str | None = None,
        sha256: str | None = None,
        name: str | None = None,
        order: ShapeOrder = "oldest",
        cursor: str | None = None,
        limit: int = 100,
    ) -> ShapePage:
        """Return up to `limit` shapes after `cursor`; see `Shapes.page`."""
        return self.shapes.page(label=label, sha256=sha256, name=name, order=order, cursor=cursor, limit=limit)

    def iter_shapes(
        self, *, label: str | None = None, name: str | None = None, order: ShapeOrder = "oldest"
    ) -> Iterator[ShapeRecord]:
        """Yield all shapes, those of one class, or those whose name contains a text, in the order of adding."""
        cursor: str | None = None
        while True:
            page = self.page(label=label, name=name, order=order, cursor=cursor)
            yield from page.items
            cursor = page.next_cursor
            if cursor is None:
                return

    def __iter__(self) -> Iterator[ShapeRecord]:
        return self.iter_shapes()

    def has(self, shape_id: str) -> bool:
        """Return whether there is a shape of this id."""
        try:
            self.get(shape_id)
        except NotFoundError:
            return False
        return True

    def __contains__(self, shape: object) -> bool:
        """Return whether a shape, or a shape of this id, is stored."""
        shape_id = shape.id if isinstance(shape, ShapeRecord) else shape
        return isinstance(shape_id, str) and self.has(shape_id)

    def count(self) -> int:
        """Return the number of shapes."""
        return len(self.shapes)

    def __len__(self) -> int:
        return self.count()

    def __bool__(self) -> bool:
        return True  # an empty library is a library

    def change(self, shape_id: str, **changes: Any) -> ShapeRecord:
        """Set some of a shape's `name`, `label` (None for no class) and `metadata`, and return the shape.

        Raises
        ------
        ParameterError
            If a value cannot be stored.
        NotFoundError
            If there is no such shape.
        """
        return self.shapes.change(shape_id, changes)

    def complete(self) -> Iterator[ShapeRecord]:
        """Compute the local signatures of shapes that earlier versions stored, and yield each shape.

        Raises
        ------
        MeshError
            If a stored mesh can no longer be read.
        """
        for shape in self.shapes.without_local():
            self.shapes.set_local(shape.id, pack_local(local_signatures(self._surface(shape.id))))
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

    def list_jobs(
        self, *, state: JobState | None = None, kind: JobKind | None = None, limit: int = 100
    ) -> list[JobStatus]:
        """Return at most `limit` (500 at most) jobs of a service that uses this library, the newest first.

        Raises
        ------
        ParameterError
            If `limit` is below 1, or there is no such state or kind.
        """
        if limit < 1:
            raise ParameterError(f"limit must be at least 1, not {limit}")
        if state is not None:
            check_choice("state", state, get_args(JobState))
        if kind is not None:
            check_choice("kind", kind, get_args(JobKind))
        page, ahead = self.jobs.read_page(JobFilter(state, kind), cursor=None, limit=min(limit, MAX_PAGE))
        return [job.status(ahead.get(job.id)) for job in page.items]

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
        NotFoundError
            If somebody removes a shape meanwhile whose file is in an object store.
        """
        return export(self.store, self.files, folder)

    def rank(
        self,
        query: Signature | MeshSource,
        *,
        measure: str = DEFAULT_MEASURE,
        classifier: str = DEFAULT_CLASSIFIER,
        k: int = DEFAULT_K,
        exact: bool = False,
        label: str | None = None,
        metadata: Mapping[str, Scalar] | None = None,
        parameters: ParametersLike = None,
        policy: PolicyLike = None,
    ) -> Ranking:
        """Rank classes and the `k` nearest shapes.

        Parameters
        ----------
        query : str, mesh as for `add`, or Signature
            The id of a stored shape, which is then not among the results; or a mesh, which is not stored; or its
            signature.
        measure : str
            `spectrum` by default, the best for whole shapes; `combined`, `moments`, `distribution`, `dimension` and
            `surface_moments` compare other descriptors. A measure of whole shapes (`rigid`, `hausdorff`,
            `max_hausdorff`, `reeb`) reorders the shapes that are nearest by the default measure. Classes are then
            ranked by the default measure. A measure of parts (`partial`, `partial_any_scale`) ranks wholes for a piece
            and pieces for a whole; a signature needs `compute_signature(..., local=True)` for it.
        classifier : {"nearest", "vote", "mean", "discriminants"}
            The rule that turns distances from shapes into distances from classes: the nearest shape, a vote of near
            ones, the mean of the class, or linear discriminants.
        k : int
            Number of shapes to return, at most 100 for a measure of whole shapes; all classes are returned.
        exact : bool, default False
            Compare every shape, even if the database has an approximate index.
        label : str, optional
            Compare only shapes of this class.
        metadata : mapping, optional
            Compare only shapes whose metadata have these members, with these values: text, numbers, booleans or None.
        parameters, policy : optional
            As for `add`, for a query that is a mesh.

        Returns
        -------
        Ranking
            `exact` says whether every shape was compared. Only shapes whose signatures were computed with the query's
            parameters take part. If there are none, a warning says which parameters the shapes have.

        Raises
        ------
        NotFoundError
            If there is no such shape or file.
        ParameterError
            If there is no such measure or classifier, `k` is below 1, or above `MAX_PAIRS` for a measure of
            whole shapes; UnsuitedError if the classifier needs more labels.
        MeshError
            As by `read_mesh` and `compute_signature`.
        """
        request = QueryRequest(measure, classifier, k, exact, label, dict(metadata or {}))
        if isinstance(query, Signature):
            return self.search.rank(query, request)
        shape_id = shape_id_of(query)
        if shape_id is not None:
            return self.search.rank(shape_id, request)
        file, local = bytes_of(query), request.part_measure is not None
        found = signature_of_file(
            file.data, Parameters.of(parameters), MeshPolicy.of(policy), file_type=file.file_type, local=local
        )
        return self.search.rank(found.signature, request)

    def nearest(
        self,
        query: Signature | MeshSource,
        k: int = DEFAULT_K,
        *,
        measure: str = DEFAULT_MEASURE,
        parameters: ParametersLike = None,
        policy: PolicyLike = None,
    ) -> Sequence[ShapeMatch]:
        """Return the `k` nearest shapes, as `rank` finds them."""
        return self.rank(query, measure=measure, k=k, parameters=parameters, policy=policy).shapes

    def classify(
        self,
        query: Signature | MeshSource,
        *,
        measure: str = DEFAULT_MEASURE,
        classifier: str = DEFAULT_CLASSIFIER,
        parameters: ParametersLike = None,
        policy: PolicyLike = None,
    ) -> Sequence[ClassMatch]:
        """Return the classes, the most likely first, as `rank` finds them."""
        ranking = self.rank(query, measure=measure, classifier=classifier, k=1, parameters=parameters, policy=policy)
        return ranking.classes

    def match(self, a: str, b: str, *, orientation: Turn = "keep", part: Part = "auto", samples: int = 300) -> PointMap:
        """Return for each vertex of the stored shape `a` its point of the stored shape `b`; see `unbend.match`.

        Raises
        ------
        NotFoundError
            If there is no such shape.
        UnsuitedError
            If the shapes cannot be matched.
        """
        surfaces = [self._surface(shape_id) for shape_id in (a, b)]
        found = match(*surfaces, orientation=orientation, part=part, samples=samples)
        return PointMap.of(found, *surfaces)

    def _surface(self, shape_id: str) -> Surface:
        shape = self.get(shape_id)
        return read_mesh(self.shapes.file(shape.sha256), file_type=shape.file_type, policy=shape.policy)

    def evaluate(self, measure: str = DEFAULT_MEASURE, *, parameters: ParametersLike = None) -> RetrievalMetrics:
        """Return the retrieval metrics of `evaluation`."""
        return cast("RetrievalMetrics", self.evaluation(measure, parameters=parameters).metrics)

    def evaluation(self, measure: str = DEFAULT_MEASURE, *, parameters: ParametersLike = None) -> EvaluationResult:
        """Evaluate retrieval among the labelled shapes computed with `parameters`, overall and by class.

        In a very large library, only some of the shapes are queries, chosen evenly.

        Raises
        ------
        ParameterError
            If there is no such measure, or it does not compare vectors; UnsuitedError if no shape has these parameters,
            or no class has two members.
        """
        return self.search.evaluation(measure, Parameters.of(parameters))

    def map(
        self,
        measure: str = DEFAULT_MEASURE,
        *,
        parameters: ParametersLike = None,
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
        return self.search.map(measure, Parameters.of(parameters), MapOptions(dimensions, limit, distance))
