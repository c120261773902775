"""The synchronous client. `make client` writes this file from `async_client.py`: edit that one."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Generic, Self, TypeVar, cast

import httpx

from unbend.brief import brief
from unbend.client import protocol
from unbend.client.events import EventReader
from unbend.client.protocol import POLL_SECONDS
from unbend.client.retries import RETRY_SECONDS, Attempts
from unbend.client.uploads import Details, MeshFile, QueryOptions, UploadProgress
from unbend.correspondence.match import Turn
from unbend.correspondence.pieces import Part
from unbend.errors import NotFoundError, ServiceError
from unbend.matching.classification import ClassMatch
from unbend.matching.evaluate import RetrievalMetrics
from unbend.mesh.policy import PolicyLike
from unbend.mesh.sources import MeshSource
from unbend.results import (
    AddedShape,
    EvaluationResult,
    JobStatus,
    PointMap,
    Ranking,
    ShapeMap,
    ShapeMatch,
    ShapePage,
    ShapeRecord,
)
from unbend.results.jobs import JobKind, JobState
from unbend.results.maps import MapDistance
from unbend.results.rankings import DEFAULT_K
from unbend.results.shapes import IfKnown, ShapeOrder
from unbend.signature.files import load_signature
from unbend.signature.parameters import ParametersLike
from unbend.signature.signature import Signature

_TIMEOUT = httpx.Timeout(POLL_SECONDS + 30.0, connect=10.0)


R = TypeVar("R")


class Job(Generic[R]):
    """A job of the service, such as `submit` returns."""

    def __init__(self, client: SyncClient, status: JobStatus, shape: AddedShape | None = None) -> None:
        self._client = client
        self._status = status
        self._shape = shape

    @property
    def id(self) -> str:
        """The identifier of the job; empty if the shape was stored already, which needs no job."""
        return self._status.id

    def status(self) -> JobStatus:
        """Return the present state of the job."""
        if not self._status.finished:
            self._ask({})
        return self._status

    def wait(self, timeout: float | None = None) -> JobStatus:
        """Return the job once it has ended; TimeoutError after `timeout` seconds, never by default."""
        end = None if timeout is None else time.monotonic() + timeout
        while not self._status.finished:
            left = POLL_SECONDS if end is None else end - time.monotonic()
            self._ask({"wait": max(0.0, min(POLL_SECONDS, left))})
            if left <= 0 and not self._status.finished:
                raise TimeoutError(f"job {self.id} is {self._status.state} after {timeout} seconds")
        return self._status

    def events(self) -> Iterator[JobStatus]:
        """Yield the job at each change of state, stage or progress; the last item is the ended job.

        The events continue after broken connections and restarts of the service, without repetition.
        """
        if self._status.finished:
            yield self._status
            return
        for status in self._client.job_events(self.id):
            self._status = status
            yield status

    def result(self, timeout: float | None = None) -> R:
        """Return the stored shape of an upload, the ranking of a query, or the file that the job made.

        If two clients upload one file at the same time, `is_new` may be true for both.

        Raises
        ------
        UnbendError
            The error of a job that failed; JobCancelledError if it was cancelled.
        TimeoutError
            If the job has not ended after `timeout` seconds; there is no limit by default.
        """
        return cast("R", self._shape or self._result_of(protocol.outcome(self.wait(timeout))))

    def _result_of(self, status: JobStatus) -> AddedShape | Ranking | bytes:
        if status.kind == "query":
            return protocol.ranking_of(status)
        if status.kind == "file":
            return (self._client.request("GET", f"{protocol.job_path(self.id)}/file")).content
        shape = self._client.get(status.shape_id or "")
        return AddedShape.of(shape, is_new=not status.ignored, ignored=status.ignored)

    def cancel(self) -> JobStatus:
        """Cancel the job and return it; an ended job does not change."""
        if not self._status.finished:
            response = self._client.request("DELETE", protocol.job_path(self.id))
            self._status = JobStatus.from_dict(response.json())
        return self._status

    def _ask(self, params: Mapping[str, float]) -> None:
        response = self._client.request("GET", protocol.job_path(self.id), params=params)
        self._status = JobStatus.from_dict(response.json())


class SyncClient:
    """A connection to a running service, with the methods and results of `Library`.

    Parameters
    ----------
    base_url : str, optional
        For example "http://127.0.0.1:8000"; by default the environment variable UNBEND_URL.
    api_key : str, optional
        By default the environment variable UNBEND_API_KEY.
    retry_seconds : float, default 600
        How long a request waits and is repeated while the service is at a limit.

    Raises
    ------
    UnbendError
        By every method, the error that the service reports, of the same class as in the library: for example
        NotFoundError if there is no such shape or job, and ParameterError if a value is refused. `status` and
        `problem` have the whole response.
    ServiceError
        By every method, if the service cannot be reached. A request is repeated first, if it is safe to repeat it.

    Examples
    --------
    >>> with SyncClient("http://127.0.0.1:8000") as client:         # doctest: +SKIP
    ...     client.add("cat.off", label="cat")
    ...     (client.classify("unknown.ply"))[0].label
    """

    def __init__(
        self, base_url: str | None = None, api_key: str | None = None, *, retry_seconds: float = RETRY_SECONDS
    ) -> None:
        self._retry_seconds = retry_seconds
        self._http = httpx.Client(
            base_url=protocol.address(base_url), headers=protocol.headers(api_key), timeout=_TIMEOUT
        )

    def __repr__(self) -> str:
        place = repr(str(self._http.base_url.copy_with(userinfo=b"")))  # numbers of shapes would be requests
        return brief(self, place, "closed" if self._http.is_closed else "")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Send any request of the HTTP API, and repeat it as `Attempts` says."""
        response, _ = self._send(method, path, **options)
        return protocol.checked(response)

    def _send(self, method: str, path: str, **options: Any) -> tuple[httpx.Response, Attempts]:
        """Return the last response, and the attempts at the request."""
        if self._http.is_closed:
            raise ServiceError("the client is closed")
        attempts = Attempts.of(method, httpx.Headers(options.get("headers")), self._retry_seconds)
        while True:
            try:
                response = self._http.request(method, path, **options)
                pause = attempts.pause_after(response)
                if pause is None:
                    return response, attempts
            except httpx.TransportError as error:
                pause = attempts.pause_after_error(error)
                if pause is None:
                    raise protocol.unreachable(self._http.base_url, error) from error
            except httpx.InvalidURL as error:
                raise protocol.unreachable(self._http.base_url, error) from error
            time.sleep(pause)

    # Shapes

    def submit(
        self,
        source: MeshSource,
        *,
        name: str | None = None,
        label: str | None = None,
        metadata: Mapping[str, Any] | None = None,
        parameters: ParametersLike = None,
        policy: PolicyLike = None,
        if_known: IfKnown = "keep",
        progress: UploadProgress | None = None,
    ) -> Job[AddedShape]:
        """Upload a mesh to store it, and return its job. `add` also waits for the job.

        Parameters
        ----------
        source, name, label, metadata, parameters, policy, if_known
            As for `add`.
        progress : callable, optional
            Called with the number of bytes that are sent, and of all bytes to send. A file named by its path is read
            while it is sent.
        """
        details = Details(name, label, metadata, parameters, policy, if_known)
        with ExitStack() as stack:
            content = details.content(stack.enter_context(MeshFile.of(source, progress)))
            response = self.request("POST", "/v1/shapes", headers=protocol.once(), **content)
        if response.status_code == httpx.codes.OK:
            shape = protocol.known_shape(response.json())
            return Job(self, protocol.finished(shape), shape)
        return Job(self, JobStatus.from_dict(response.json()))

    def add(
        self,
        source: MeshSource,
        *,
        name: str | None = None,
        label: str | None = None,
        metadata: Mapping[str, Any] | None = None,
        parameters: ParametersLike = None,
        policy: PolicyLike = None,
        if_known: IfKnown = "keep",
        timeout: float | None = None,
        progress: UploadProgress | None = None,
    ) -> AddedShape:
        """Upload a mesh, and return the stored shape once the service has computed its signature.

        Parameters
        ----------
        source : bytes, str, Path, binary file, Surface, pair of arrays, or mesh object
            A mesh, as `read_mesh` takes it.
        name : str, optional
            By default the stem of the file's name, or "unnamed".
        label : str, optional
            The known class of the shape.
        metadata : dict, optional
            JSON values.
        parameters : Parameters or mapping, optional
        policy : MeshPolicy or mapping, optional
            How to read the mesh.
        if_known : {"keep", "update"}
            Whether a shape that is stored already, from the same file with the same parameters and policy, keeps its
            name, label and metadata, or takes the new ones.
        timeout : float, optional
            Seconds to wait for the service; no limit by default.
        progress : callable, optional
            Called with the number of bytes that are sent, and of all bytes to send.

        Raises
        ------
        MeshError
            If the mesh cannot be read or computed.
        ParameterError
            If the name, label or metadata cannot be stored.
        TimeoutError
            After `timeout` seconds.
        """
        job = self.submit(
            source, name=name, label=label, metadata=metadata, parameters=parameters, policy=policy,
            if_known=if_known, progress=progress,
        )  # fmt: skip
        return job.result(timeout)

    def get(self, shape_id: str) -> ShapeRecord:
        """Return a shape; NotFoundError if there is none of this id."""
        return ShapeRecord.from_dict((self.request("GET", protocol.shape_path(shape_id))).json())

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
        """Return up to `limit` (at most 500) shapes after `cursor`, in the order of adding or in reverse.

        Parameters
        ----------
        label : str, optional
            Only shapes of this class.
        sha256 : str, optional
            Only shapes made from the file with this hash.
        name : str, optional
            Only shapes whose name contains this text, in either case.
        order : {"oldest", "newest"}
            The shape that comes first.
        cursor : str, optional
            `next_cursor` of the page before, in the same order.
        limit : int, default 100
        """
        params = protocol.given(label=label, sha256=sha256, name=name, order=order, cursor=cursor, limit=limit)
        return ShapePage.from_dict((self.request("GET", "/v1/shapes", params=params)).json())

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

    def count(self) -> int:
        """Return the number of shapes."""
        return int((self.request("GET", "/v1/classes")).json()["shapes"])

    def labels(self) -> dict[str, int]:
        """Return the number of shapes of each class."""
        return {item["label"]: item["count"] for item in (self.request("GET", "/v1/classes")).json()["items"]}

    def change(self, shape_id: str, **changes: Any) -> ShapeRecord:
        """Set some of a shape's `name`, `label` (None for no class) and `metadata`, and return the shape."""
        response = self.request("PATCH", protocol.shape_path(shape_id), json=protocol.body(**changes))
        return ShapeRecord.from_dict(response.json())

    def remove(self, shape_id: str) -> None:
        """Remove a shape, its signature, descriptors and file."""
        response, attempts = self._send("DELETE", protocol.shape_path(shape_id))
        # An earlier attempt, whose answer was lost, may have removed the shape.
        if response.status_code != httpx.codes.NOT_FOUND or not attempts.may_have_arrived:
            protocol.checked(response)

    def mesh(self, shape_id: str) -> bytes:
        """Return the file that a shape was made from, byte for byte."""
        return (self.request("GET", f"{protocol.shape_path(shape_id)}/mesh")).content

    def signature(self, shape_id: str) -> Signature:
        """Return a shape's signature."""
        path = f"{protocol.shape_path(shape_id)}/signature"
        return load_signature((self.request("GET", path, params={"format": "npz"})).content)

    # Queries

    def rank(
        self,
        query: MeshSource,
        *,
        measure: str | None = None,
        classifier: str | None = None,
        k: int = DEFAULT_K,
        exact: bool = False,
        label: str | None = None,
        metadata: Mapping[str, Any] | None = None,
        parameters: ParametersLike = None,
        policy: PolicyLike = None,
        timeout: float | None = None,
        progress: UploadProgress | None = None,
    ) -> Ranking:
        """Rank classes and the `k` nearest shapes.

        Parameters
        ----------
        query : str, or mesh as for `add`
            The id of a stored shape, which is then not among the results; or a mesh, which is not stored.
        measure, classifier : str, optional
            By default those of the service. `Library.rank` lists them.
        k : int
            Number of shapes to return; all classes are returned.
        exact : bool, default False
            Compare every shape, even if the database of the service has an approximate index.
        label : str, optional
            Compare only shapes of this class.
        metadata : mapping, optional
            Compare only shapes whose metadata have these members, with these values: text, numbers, booleans or None.
        parameters, policy : optional
            As for `add`, for a query that is a mesh.
        timeout, progress : optional
            As for `add`.

        Raises
        ------
        NotFoundError
            If there is no such shape or file.
        ParameterError
            If there is no such measure or classifier, or `k` is out of range; UnsuitedError if the classifier needs
            more labels.
        MeshError
            If the mesh cannot be read or computed.
        """
        options = QueryOptions(measure, classifier, k, exact or None, label, metadata)
        shape_id = protocol.stored(query)
        if shape_id is not None:
            body = options.of_shape(shape_id)
            response = self.request("POST", "/v1/queries", headers=protocol.once(), json=body)
            return Ranking.from_dict(response.json())
        with ExitStack() as stack:
            content = options.content(stack.enter_context(MeshFile.of(query, progress)), parameters, policy)
            response = self.request("POST", "/v1/queries", headers=protocol.once() | protocol.IN_PLACE, **content)
        if response.status_code == httpx.codes.OK:
            return Ranking.from_dict(response.json())
        job = Job[Ranking](self, JobStatus.from_dict(response.json()))
        return job.result(timeout)

    def nearest(
        self,
        query: MeshSource,
        k: int = DEFAULT_K,
        *,
        measure: str | None = None,
        parameters: ParametersLike = None,
        policy: PolicyLike = None,
    ) -> Sequence[ShapeMatch]:
        """Return the `k` nearest shapes, as `rank` finds them."""
        return (self.rank(query, measure=measure, k=k, parameters=parameters, policy=policy)).shapes

    def classify(
        self,
        query: MeshSource,
        *,
        measure: str | None = None,
        classifier: str | None = None,
        parameters: ParametersLike = None,
        policy: PolicyLike = None,
    ) -> Sequence[ClassMatch]:
        """Return the classes, the most likely first, as `rank` finds them."""
        ranking = self.rank(query, measure=measure, classifier=classifier, k=1, parameters=parameters, policy=policy)
        return ranking.classes

    def match(
        self,
        a: str,
        b: str,
        *,
        orientation: Turn = "keep",
        part: Part = "auto",
        samples: int = 300,
        timeout: float | None = None,
    ) -> PointMap:
        """Return for each vertex of the stored shape `a` its point of the stored shape `b`; see `unbend.match`.

        Raises
        ------
        NotFoundError
            If there is no such shape.
        UnsuitedError
            If the shapes cannot be matched.
        TimeoutError
            After `timeout` seconds; there is no limit by default.
        """
        wanted = {"a": a, "b": b, "orientation": orientation, "part": part, "samples": samples, "format": "npz"}
        response = self.request("POST", "/v1/matches", headers=protocol.once(), json=wanted)
        job = Job[bytes](self, JobStatus.from_dict(response.json()))
        return protocol.points(job.result(timeout))

    def map(
        self,
        measure: str | None = None,
        *,
        parameters: ParametersLike = None,
        dimensions: int = 2,
        limit: int | None = None,
        distance: MapDistance = "l1",
    ) -> ShapeMap:
        """Embed the shapes so that similar shapes are near each other (the paper's Fig. 8); see `Library.map`."""
        params = protocol.given(
            measure=measure, parameters=parameters, dimensions=dimensions, limit=limit, distance=distance
        )
        return ShapeMap.from_dict((self.request("GET", "/v1/map", params=params)).json())

    def evaluate(self, measure: str | None = None, *, parameters: ParametersLike = None) -> RetrievalMetrics:
        """Return the retrieval metrics of `evaluation`."""
        return cast("RetrievalMetrics", (self.evaluation(measure, parameters=parameters)).metrics)

    def evaluation(self, measure: str | None = None, *, parameters: ParametersLike = None) -> EvaluationResult:
        """Evaluate retrieval among the labelled shapes, overall and by class; see `Library.evaluation`."""
        params = protocol.given(measure=measure, parameters=parameters)
        return EvaluationResult.from_dict((self.request("GET", "/v1/evaluation", params=params)).json())

    # Jobs

    def list_jobs(
        self, *, state: JobState | None = None, kind: JobKind | None = None, limit: int = 100
    ) -> list[JobStatus]:
        """Return at most `limit` (500 at most) jobs, the newest first."""
        params = protocol.given(state=state, kind=kind, limit=limit)
        items = (self.request("GET", "/v1/jobs", params=params)).json()["items"]
        return [JobStatus.from_dict(item) for item in items]

    def job(self, job_id: str) -> Job[AddedShape | Ranking | bytes]:
        """Return a job by its identifier; NotFoundError if there is none."""
        return Job(self, JobStatus.from_dict((self.request("GET", protocol.job_path(job_id))).json()))

    def job_events(self, job_id: str) -> Iterator[JobStatus]:
        """Yield a job at each change until it ends; NotFoundError if there is none of this id."""
        reader = EventReader(self._http.base_url)
        while True:
            broken: Exception | None = None
            try:
                path = f"{protocol.job_path(job_id)}/events"
                with self._http.stream("GET", path, headers=reader.headers) as response:
                    if response.is_error:
                        response.read()
                    if reader.opened(response):
                        for line in response.iter_lines():
                            if (job := reader.feed(line)) is not None:
                                yield JobStatus.from_dict(job)
            except httpx.TransportError as error:
                broken = error
            if reader.done:
                return
            time.sleep(reader.interrupted(broken))
