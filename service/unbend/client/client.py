"""The synchronous and the asynchronous client, with the same methods."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from types import TracebackType
from typing import Any, Self

import httpx

from unbend.client import protocol
from unbend.client.events import EventReader
from unbend.client.protocol import FINISHED, POLL_SECONDS, Details, Json, MeshFile, QueryOptions
from unbend.client.retries import RETRY_SECONDS, Attempts
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.sources import MeshSource
from unbend.signature.parameters import Parameters

_TIMEOUT = httpx.Timeout(POLL_SECONDS + 30.0, connect=10.0)


class Job:
    """A job of the service, as `Client.submit` returns it."""

    def __init__(self, client: Client, record: Json, shape: Json | None = None) -> None:
        self._client = client
        self._record = record
        self._shape = shape

    @property
    def id(self) -> str:
        """The identifier of the job."""
        return str(self._record["id"])

    def status(self) -> Json:
        """Return the present state of the job: state, stage, progress, position."""
        if self._record["state"] not in FINISHED:
            self._record = self._client.request("GET", protocol.job_path(self.id)).json()
        return self._record

    def wait(self, timeout: float | None = None) -> Json:
        """Return the job once it has ended; TimeoutError after `timeout` seconds, never by default."""
        end = None if timeout is None else time.monotonic() + timeout
        while self._record["state"] not in FINISHED:
            patience = POLL_SECONDS if end is None else min(POLL_SECONDS, end - time.monotonic())
            if patience <= 0:
                raise TimeoutError(f"job {self.id} is {self._record['state']} after {timeout} seconds")
            self._record = self._client.request("GET", protocol.job_path(self.id), params={"wait": patience}).json()
        return self._record

    def events(self) -> Iterator[Json]:
        """Yield the job at each change of state, stage or progress; the last item is the ended job.

        The events continue after broken connections and restarts of the service, without repetition.
        """
        if self._record["state"] in FINISHED:
            yield self._record
            return
        for record in self._client.job_events(self.id):
            self._record = record
            yield record

    def result(self, timeout: float | None = None) -> Json:
        """Return the stored shape, or a query's ranking; raise the job's own error if it failed."""
        if self._shape is not None:
            return self._shape
        job = protocol.outcome(self.wait(timeout))
        return self._client.shape(job["shape_id"]) if job["kind"] == "shape" else job["result"]

    def cancel(self) -> Json:
        """Cancel the job and return it; an ended job does not change."""
        if self._shape is None:
            self._record = self._client.request("DELETE", protocol.job_path(self.id)).json()
        return self._record


class Client:
    """A connection to a running service.

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
    >>> with Client("http://127.0.0.1:8000") as client:         # doctest: +SKIP
    ...     shape = client.submit("cat.off", label="cat").result()
    ...     client.query("unknown.ply")["classes"][0]["label"]
    """

    def __init__(
        self, base_url: str | None = None, api_key: str | None = None, *, retry_seconds: float = RETRY_SECONDS
    ) -> None:
        self._retry_seconds = retry_seconds
        self._http = httpx.Client(
            base_url=protocol.address(base_url), headers=protocol.headers(api_key), timeout=_TIMEOUT
        )

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
        attempts = Attempts.of(method, httpx.Headers(options.get("headers")), self._retry_seconds)
        while True:
            try:
                response = self._http.request(method, path, **options)
                pause = attempts.pause_after(response)
                if pause is None:
                    return protocol.checked(response)
            except httpx.TransportError as error:
                pause = attempts.pause_after_error(error)
                if pause is None:
                    raise protocol.unreachable(self._http.base_url, error) from error
            except httpx.InvalidURL as error:
                raise protocol.unreachable(self._http.base_url, error) from error
            time.sleep(pause)

    def submit(
        self,
        source: MeshSource,
        *,
        name: str | None = None,
        label: str | None = None,
        metadata: Mapping[str, Any] | None = None,
        parameters: Parameters | Mapping[str, Any] | None = None,
        policy: MeshPolicy | Mapping[str, Any] | None = None,
        if_known: str | None = None,
    ) -> Job:
        """Upload a mesh to store it, and return its job. `result()` is the shape, at once if it is stored already.

        A known shape takes the name, label and metadata if `if_known` is "update"; otherwise it keeps its own, and
        `ignored` names the fields that differ.
        """
        content = protocol.upload_content(
            MeshFile.of(source), Details(name, label, metadata, parameters, policy, if_known)
        )
        response = self.request("POST", "/v1/shapes", headers=protocol.once(), **content)
        return Job(self, *protocol.submitted(response))

    def query(
        self,
        source: MeshSource,
        *,
        measure: str | None = None,
        classifier: str | None = None,
        k: int = 10,
        parameters: Parameters | Mapping[str, Any] | None = None,
        policy: MeshPolicy | Mapping[str, Any] | None = None,
        timeout: float | None = None,
    ) -> Json:
        """Return the ranking of classes and shapes for a mesh, without storing it."""
        content = protocol.query_content(MeshFile.of(source), QueryOptions(measure, classifier, k), parameters, policy)
        response = self.request("POST", "/v1/queries", headers=protocol.once() | protocol.IN_PLACE, **content)
        if response.status_code == httpx.codes.OK:
            return dict(response.json())
        return Job(self, response.json()).result(timeout)

    def query_shape(
        self, shape_id: str, *, measure: str | None = None, classifier: str | None = None, k: int = 10
    ) -> Json:
        """Return the ranking for a stored shape."""
        body = protocol.shape_query(shape_id, QueryOptions(measure, classifier, k))
        return dict(self.request("POST", "/v1/queries", json=body).json())

    def match(
        self,
        a: str,
        b: str,
        *,
        orientation: str | None = None,
        part: str | None = None,
        samples: int | None = None,
        timeout: float | None = None,
    ) -> Json:
        """Return for each vertex of the stored shape `a` its point of the stored shape `b`.

        `corners` and `barycentric` have three vertices of the file of `b` and their weights, and `confidence` one
        number for each vertex of the file of `a`.
        """
        job = Job(
            self, self.request("POST", "/v1/matches", json=protocol.match(a, b, orientation, part, samples)).json()
        )
        protocol.outcome(job.wait(timeout))
        return dict(self.request("GET", protocol.file_path(job.id)).json())

    def shape(self, shape_id: str) -> Json:
        """Return a shape's record."""
        return dict(self.request("GET", f"/v1/shapes/{shape_id}").json())

    def shapes(self, *, label: str | None = None) -> Iterator[Json]:
        """Yield all shapes in the order of adding."""
        cursor: str | None = None
        while True:
            page = self.request("GET", "/v1/shapes", params=protocol.page(label, cursor)).json()
            yield from page["items"]
            cursor = page["next_cursor"]
            if cursor is None:
                return

    def signature(self, shape_id: str) -> Json:
        """Return the signature of a shape."""
        return dict(self.request("GET", f"/v1/shapes/{shape_id}/signature").json())

    def change(self, shape_id: str, **changes: Any) -> Json:
        """Change a shape's name, label or metadata."""
        return dict(self.request("PATCH", f"/v1/shapes/{shape_id}", json=changes).json())

    def remove(self, shape_id: str) -> None:
        """Remove a shape."""
        self.request("DELETE", f"/v1/shapes/{shape_id}")

    def job(self, job_id: str) -> Job:
        """Return a job by its identifier."""
        return Job(self, self.request("GET", protocol.job_path(job_id)).json())

    def job_events(self, job_id: str) -> Iterator[Json]:
        """Yield a job at each change until it ends; NotFoundError if there is none of this id."""
        reader = EventReader(self._http.base_url)
        while True:
            broken: Exception | None = None
            try:
                with self._http.stream("GET", protocol.events_path(job_id), headers=reader.headers) as response:
                    if response.is_error:
                        response.read()
                    if reader.opened(response):
                        for line in response.iter_lines():
                            if (job := reader.feed(line)) is not None:
                                yield job
            except httpx.TransportError as error:
                broken = error
            if reader.done:
                return
            time.sleep(reader.interrupted(broken))

    def classes(self) -> dict[str, int]:
        """Return the number of shapes of each class."""
        return {item["label"]: item["count"] for item in self.request("GET", "/v1/classes").json()["items"]}

    def map(
        self,
        *,
        measure: str | None = None,
        parameters: Parameters | Mapping[str, Any] | None = None,
        distance: str | None = None,
    ) -> Json:
        """Return the map of the stored shapes; `distance` is "l1" or "squared_l2"."""
        return dict(self.request("GET", "/v1/map", params=protocol.overview(measure, parameters, distance)).json())

    def evaluation(
        self, *, measure: str | None = None, parameters: Parameters | Mapping[str, Any] | None = None
    ) -> Json:
        """Return the retrieval metrics of the stored shapes."""
        return dict(self.request("GET", "/v1/evaluation", params=protocol.overview(measure, parameters)).json())


class AsyncJob:
    """A job of the service, as `AsyncClient.submit` returns it."""

    def __init__(self, client: AsyncClient, record: Json, shape: Json | None = None) -> None:
        self._client = client
        self._record = record
        self._shape = shape

    @property
    def id(self) -> str:
        """The identifier of the job."""
        return str(self._record["id"])

    async def status(self) -> Json:
        """Return the present state of the job: state, stage, progress, position."""
        if self._record["state"] not in FINISHED:
            self._record = (await self._client.request("GET", protocol.job_path(self.id))).json()
        return self._record

    async def wait(self, timeout: float | None = None) -> Json:
        """Return the job once it has ended; TimeoutError after `timeout` seconds, never by default."""
        async with asyncio.timeout(timeout):
            while self._record["state"] not in FINISHED:
                params = {"wait": POLL_SECONDS}
                self._record = (await self._client.request("GET", protocol.job_path(self.id), params=params)).json()
        return self._record

    async def events(self) -> AsyncIterator[Json]:
        """Yield the job at each change of state, stage or progress; the last item is the ended job.

        The events continue after broken connections and restarts of the service, without repetition.
        """
        if self._record["state"] in FINISHED:
            yield self._record
            return
        async for record in self._client.job_events(self.id):
            self._record = record
            yield record

    async def result(self, timeout: float | None = None) -> Json:
        """Return the stored shape, or a query's ranking; raise the job's own error if it failed."""
        if self._shape is not None:
            return self._shape
        job = protocol.outcome(await self.wait(timeout))
        return await self._client.shape(job["shape_id"]) if job["kind"] == "shape" else job["result"]

    async def cancel(self) -> Json:
        """Cancel the job and return it; an ended job does not change."""
        if self._shape is None:
            self._record = (await self._client.request("DELETE", protocol.job_path(self.id))).json()
        return self._record


class AsyncClient:
    """`Client` for asyncio, with the same methods."""

    def __init__(
        self, base_url: str | None = None, api_key: str | None = None, *, retry_seconds: float = RETRY_SECONDS
    ) -> None:
        self._retry_seconds = retry_seconds
        self._http = httpx.AsyncClient(
            base_url=protocol.address(base_url), headers=protocol.headers(api_key), timeout=_TIMEOUT
        )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connection."""
        await self._http.aclose()

    async def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Send any request of the HTTP API, and repeat it as `Attempts` says."""
        attempts = Attempts.of(method, httpx.Headers(options.get("headers")), self._retry_seconds)
        while True:
            try:
                response = await self._http.request(method, path, **options)
                pause = attempts.pause_after(response)
                if pause is None:
                    return protocol.checked(response)
            except httpx.TransportError as error:
                pause = attempts.pause_after_error(error)
                if pause is None:
                    raise protocol.unreachable(self._http.base_url, error) from error
            except httpx.InvalidURL as error:
                raise protocol.unreachable(self._http.base_url, error) from error
            await asyncio.sleep(pause)

    async def submit(
        self,
        source: MeshSource,
        *,
        name: str | None = None,
        label: str | None = None,
        metadata: Mapping[str, Any] | None = None,
        parameters: Parameters | Mapping[str, Any] | None = None,
        policy: MeshPolicy | Mapping[str, Any] | None = None,
        if_known: str | None = None,
    ) -> AsyncJob:
        """Upload a mesh to store it, and return its job. `result()` is the shape, at once if it is stored already.

        A known shape takes the name, label and metadata if `if_known` is "update"; otherwise it keeps its own, and
        `ignored` names the fields that differ.
        """
        mesh = await asyncio.to_thread(MeshFile.of, source)
        content = protocol.upload_content(mesh, Details(name, label, metadata, parameters, policy, if_known))
        return AsyncJob(
            self, *protocol.submitted(await self.request("POST", "/v1/shapes", headers=protocol.once(), **content))
        )

    async def query(
        self,
        source: MeshSource,
        *,
        measure: str | None = None,
        classifier: str | None = None,
        k: int = 10,
        parameters: Parameters | Mapping[str, Any] | None = None,
        policy: MeshPolicy | Mapping[str, Any] | None = None,
        timeout: float | None = None,
    ) -> Json:
        """Return the ranking of classes and shapes for a mesh, without storing it."""
        mesh = await asyncio.to_thread(MeshFile.of, source)
        content = protocol.query_content(mesh, QueryOptions(measure, classifier, k), parameters, policy)
        response = await self.request("POST", "/v1/queries", headers=protocol.once() | protocol.IN_PLACE, **content)
        if response.status_code == httpx.codes.OK:
            return dict(response.json())
        return await AsyncJob(self, response.json()).result(timeout)

    async def query_shape(
        self, shape_id: str, *, measure: str | None = None, classifier: str | None = None, k: int = 10
    ) -> Json:
        """Return the ranking for a stored shape."""
        body = protocol.shape_query(shape_id, QueryOptions(measure, classifier, k))
        return dict((await self.request("POST", "/v1/queries", json=body)).json())

    async def match(
        self,
        a: str,
        b: str,
        *,
        orientation: str | None = None,
        part: str | None = None,
        samples: int | None = None,
        timeout: float | None = None,
    ) -> Json:
        """Return for each vertex of a stored shape its point of another, as `Client.match` does."""
        response = await self.request("POST", "/v1/matches", json=protocol.match(a, b, orientation, part, samples))
        job = AsyncJob(self, response.json())
        protocol.outcome(await job.wait(timeout))
        return dict((await self.request("GET", protocol.file_path(job.id))).json())

    async def shape(self, shape_id: str) -> Json:
        """Return a shape's record."""
        return dict((await self.request("GET", f"/v1/shapes/{shape_id}")).json())

    async def shapes(self, *, label: str | None = None) -> AsyncIterator[Json]:
        """Yield all shapes in the order of adding."""
        cursor: str | None = None
        while True:
            page = (await self.request("GET", "/v1/shapes", params=protocol.page(label, cursor))).json()
            for item in page["items"]:
                yield item
            cursor = page["next_cursor"]
            if cursor is None:
                return

    async def signature(self, shape_id: str) -> Json:
        """Return the signature of a shape."""
        return dict((await self.request("GET", f"/v1/shapes/{shape_id}/signature")).json())

    async def change(self, shape_id: str, **changes: Any) -> Json:
        """Change a shape's name, label or metadata."""
        return dict((await self.request("PATCH", f"/v1/shapes/{shape_id}", json=changes)).json())

    async def remove(self, shape_id: str) -> None:
        """Remove a shape."""
        await self.request("DELETE", f"/v1/shapes/{shape_id}")

    async def job(self, job_id: str) -> AsyncJob:
        """Return a job by its identifier."""
        return AsyncJob(self, (await self.request("GET", protocol.job_path(job_id))).json())

    async def job_events(self, job_id: str) -> AsyncIterator[Json]:
        """Yield a job at each change until it ends; NotFoundError if there is none of this id."""
        reader = EventReader(self._http.base_url)
        while True:
            broken: Exception | None = None
            try:
                async with self._http.stream("GET", protocol.events_path(job_id), headers=reader.headers) as response:
                    if response.is_error:
                        await response.aread()
                    if reader.opened(response):
                        async for line in response.aiter_lines():
                            if (job := reader.feed(line)) is not None:
                                yield job
            except httpx.TransportError as error:
                broken = error
            if reader.done:
                return
            await asyncio.sleep(reader.interrupted(broken))

    async def classes(self) -> dict[str, int]:
        """Return the number of shapes of each class."""
        items = (await self.request("GET", "/v1/classes")).json()["items"]
        return {item["label"]: item["count"] for item in items}

    async def map(
        self,
        *,
        measure: str | None = None,
        parameters: Parameters | Mapping[str, Any] | None = None,
        distance: str | None = None,
    ) -> Json:
        """Return the map of the stored shapes; `distance` is "l1" or "squared_l2"."""
        return dict(
            (await self.request("GET", "/v1/map", params=protocol.overview(measure, parameters, distance))).json()
        )

    async def evaluation(
        self, *, measure: str | None = None, parameters: Parameters | Mapping[str, Any] | None = None
    ) -> Json:
        """Return the retrieval metrics of the stored shapes."""
        return dict((await self.request("GET", "/v1/evaluation", params=protocol.overview(measure, parameters))).json())
