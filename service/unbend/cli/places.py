"""A library or a running service, with the same methods and the same JSON values: those of the HTTP contract."""

from __future__ import annotations

from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from unbend.cli.computing import compute_file
from unbend.cli.connect import connect
from unbend.cli.options import PART_MEASURES, Values
from unbend.cli.terminal import warn_of

if TYPE_CHECKING:
    from datetime import datetime

    from unbend.client import Client
    from unbend.library import Library
    from unbend.library.records import JobRecord, ShapeRecord

T = TypeVar("T")

_PAGE: Final = 500
"""Items that a place returns at a time."""


class Place(Protocol):
    """What commands need of a library or of a service."""

    def shapes(self, label: str | None = None) -> Iterator[Values]:
        """Yield the records of the shapes, or of those of one class, in the order of adding."""

    def shape(self, shape_id: str) -> Values:
        """Return the record of a shape; NotFoundError if there is none of this id."""

    def mesh(self, shape_id: str) -> bytes:
        """Return the file that a shape was made from."""

    def set_label(self, shape_id: str, label: str | None) -> Values:
        """Set or remove the class of a shape, and return its record."""

    def remove(self, shape_id: str) -> None:
        """Remove a shape; NotFoundError if there is none of this id."""

    def rank(self, mesh: Path, parameters: Values, policy: Values, options: Values) -> Values:
        """Return the classes and shapes nearest to a mesh, and print the warnings about the mesh."""

    def evaluation(self, measure: str, parameters: Values) -> Values:
        """Return the retrieval metrics of the labelled shapes."""

    def jobs(self, state: str | None = None) -> Iterator[Values]:
        """Yield the records of the jobs, or of those in one state, the newest first."""

    def cancel(self, job_id: str) -> Values:
        """Cancel a job and return its record; an ended job does not change."""


@contextmanager
def open_place(library: str, url: str | None) -> Iterator[Place]:
    """Open the service at `url`, or otherwise an existing library."""
    if url:
        with connect(url) as client:
            yield _Service(client)
    else:
        with open_library(library) as opened:
            yield _Local(opened)


@contextmanager
def open_library(url: str) -> Iterator[Library]:
    """Open an existing library; ParameterError if there is none, because a typing error must not create one."""
    from unbend.library import Library  # noqa: PLC0415

    check_library(url)
    with Library(url) as library:
        yield library


def check_library(url: str) -> None:
    """Raise ParameterError if there is no library at `url`."""
    from unbend.errors import ParameterError  # noqa: PLC0415
    from unbend.library.storage.database import must_exist  # noqa: PLC0415

    try:
        must_exist(url)
    except ParameterError as error:
        error.advice = "Name another by --library, or make one by `unbend import`."
        raise


class _Local:
    """A library in this process."""

    def __init__(self, library: Library) -> None:
        self._library = library

    def shapes(self, label: str | None = None) -> Iterator[Values]:
        cursor: str | None = None
        while True:
            page = self._library.page(label=label, cursor=cursor, limit=_PAGE)
            yield from map(_shape, page.items)
            cursor = page.next_cursor
            if cursor is None:
                return

    def shape(self, shape_id: str) -> Values:
        return _shape(self._library.get(shape_id))

    def mesh(self, shape_id: str) -> bytes:
        return self._library.mesh(shape_id)

    def set_label(self, shape_id: str, label: str | None) -> Values:
        return _shape(self._library.change(shape_id, {"label": label}))

    def remove(self, shape_id: str) -> None:
        self._library.remove(shape_id)

    def rank(self, mesh: Path, parameters: Values, policy: Values, options: Values) -> Values:
        signature = compute_file(mesh, parameters, policy, local=options["measure"] in PART_MEASURES)
        return self._library.rank(signature, **options).as_dict()

    def evaluation(self, measure: str, parameters: Values) -> Values:
        from unbend.signature.parameters import Parameters  # noqa: PLC0415

        found = self._library.evaluation(measure, parameters=Parameters.from_dict(parameters))
        return {"measure": measure, **found.as_dict()}

    def jobs(self, state: str | None = None) -> Iterator[Values]:
        from unbend.library.jobs import JobFilter  # noqa: PLC0415

        cursor: str | None = None
        while True:
            wanted: Any = JobFilter(state=state)  # type: ignore[arg-type]
            page, ahead = _wait(self._library.jobs.page(wanted, cursor=cursor, limit=_PAGE))
            yield from (_job(record, ahead.get(record.id)) for record in page.items)
            cursor = page.next_cursor
            if cursor is None:
                return

    def cancel(self, job_id: str) -> Values:
        from unbend.errors import JobCancelledError  # noqa: PLC0415
        from unbend.jobs.failures import describe  # noqa: PLC0415

        jobs = self._library.jobs
        _wait(jobs.get(job_id))
        jobs.cancel(job_id, describe(JobCancelledError("the job was cancelled")), None).result()
        return _job(_wait(jobs.get(job_id)), None)


class _Service:
    """A running service."""

    def __init__(self, client: Client) -> None:
        self._client = client

    def shapes(self, label: str | None = None) -> Iterator[Values]:
        return self._client.shapes(label=label)

    def shape(self, shape_id: str) -> Values:
        return self._client.shape(shape_id)

    def mesh(self, shape_id: str) -> bytes:
        return self._client.request("GET", f"/v1/shapes/{shape_id}/mesh").content

    def set_label(self, shape_id: str, label: str | None) -> Values:
        return self._client.change(shape_id, label=label)

    def remove(self, shape_id: str) -> None:
        self._client.remove(shape_id)

    def rank(self, mesh: Path, parameters: Values, policy: Values, options: Values) -> Values:
        ranking = self._client.query(mesh, parameters=parameters, policy=policy, **options)
        warn_of(mesh.name, ranking.get("warnings", ()))
        return ranking

    def evaluation(self, measure: str, parameters: Values) -> Values:
        return self._client.evaluation(measure=measure, parameters=parameters)

    def jobs(self, state: str | None = None) -> Iterator[Values]:
        query = {"limit": str(_PAGE)} | ({"state": state} if state else {})
        while True:
            page = self._client.request("GET", "/v1/jobs", params=query).json()
            yield from page["items"]
            if page["next_cursor"] is None:
                return
            query["cursor"] = page["next_cursor"]

    def cancel(self, job_id: str) -> Values:
        return self._client.job(job_id).cancel()


def _wait(reading: Coroutine[Any, Any, T]) -> T:
    import asyncio  # noqa: PLC0415

    return asyncio.run(reading)


_HIDDEN: Final = frozenset({"changed", "seq"})
_JOB_FIELDS: Final = (
    "id", "kind", "state", "stage", "progress", "detail", "attempts", "error", "shape_id", "warnings", "ignored",
    "created_at", "started_at", "finished_at",
)  # fmt: skip


def _shape(record: ShapeRecord) -> Values:
    values = {name: value for name, value in vars(record).items() if name not in _HIDDEN}
    times = {name: _instant(values[name]) for name in ("created_at", "updated_at")}
    return values | times | {"parameters": record.parameters.as_dict(), "policy": record.policy.as_dict()}


def _job(record: JobRecord, position: int | None) -> Values:
    values = {name: getattr(record, name) for name in _JOB_FIELDS}
    times = {name: _instant(values[name]) for name in ("created_at", "started_at", "finished_at")}
    return values | times | {"detail": dict(record.detail), "position": position}


def _instant(time: datetime | None) -> str | None:
    """Return a time in the form of the HTTP contract."""
    return None if time is None else time.isoformat().replace("+00:00", "Z")


def first(items: Iterator[Values], limit: int | None) -> list[Values]:
    """Return the first `limit` items, or all."""
    return list(islice(items, limit))
