"""The library or the service that a command works on; both have the same methods."""

from __future__ import annotations

import re
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, Union

from unbend.cli.mesh_file import compute_file
from unbend.cli.options import PART_MEASURES, Values, chosen_objects
from unbend.cli.terminal import warn_of
from unbend.names import is_shape_id, printable

if TYPE_CHECKING:
    from unbend.client import Client
    from unbend.library import Library
    from unbend.results import JobStatus, Ranking

T = TypeVar("T")

Place = Union["Library", "Client"]

_BEGINNING: Final = re.compile(r"[0-9a-f]{6,32}")

_NAMED: Final = 2
"""Shapes that an error names."""


@contextmanager
def open_place(library: str, url: str | None) -> Iterator[Place]:
    """Open the service at `url`, or otherwise an existing library."""
    if url:
        with connect(url) as client:
            yield client
    else:
        with open_library(library) as opened:
            yield opened


def connect(url: str) -> Client:
    """Return a client of the service at `url`, with the API key of UNBEND_API_KEY.

    There is no option for the key, because it would be visible in the list of processes.
    """
    from unbend.client import Client  # noqa: PLC0415
    from unbend.errors import ParameterError  # noqa: PLC0415

    if not url.lower().startswith(("http://", "https://")):
        raise ParameterError(
            f"the address of a service begins with http:// or https://, and {url} does not"
        ).with_advice(f"Try http://{url} in --url or UNBEND_URL.")
    return Client(url)


@contextmanager
def open_library(url: str) -> Iterator[Library]:
    """Open an existing library; ParameterError if there is none, because a typing error must not create one."""
    from unbend.library import Library  # noqa: PLC0415

    check_library(url)
    with Library(url, objects=chosen_objects()) as library:
        yield library


def check_library(url: str) -> None:
    """Raise ParameterError if there is no library at `url`."""
    from unbend.errors import ParameterError  # noqa: PLC0415
    from unbend.library.storage.database import must_exist  # noqa: PLC0415

    try:
        must_exist(url)
    except ParameterError as error:
        error.with_advice("Name another by --library, or make one by `unbend import`.")
        raise


def may_begin_id(text: str) -> bool:
    """Return whether a text is the id of a shape, or at least the first 6 of its digits."""
    return _BEGINNING.fullmatch(text) is not None


def whole_id(place: Place, text: str) -> str:
    """Return the id of the only shape whose id begins with `text`; `text` itself if it is not a beginning of an id.

    A whole id is not looked up. For a beginning, all shapes of the place are listed.

    Raises
    ------
    NotFoundError
        If no id begins with it.
    ParameterError
        If several do.
    """
    from unbend.errors import NotFoundError, ParameterError  # noqa: PLC0415

    if is_shape_id(text) or not may_begin_id(text):
        return text
    found = [shape for shape in place.iter_shapes() if shape.id.startswith(text)]
    if not found:
        raise NotFoundError(f"no shape has an id that begins with {text}")
    if len(found) > 1:
        names = ", ".join(f"{shape.id} ({printable(shape.name)})" for shape in found[:_NAMED])
        raise ParameterError(f"{len(found)} shapes have an id that begins with {text}, such as {names}").with_advice(
            "Give more digits."
        )
    return found[0].id


def rank_file(place: Place, mesh: Path, parameters: Values, policy: Values, options: Values) -> Ranking:
    """Return the classes and shapes nearest to a mesh file; print progress and warnings on standard error."""
    from unbend.client import Client  # noqa: PLC0415

    if not isinstance(place, Client):
        local = options["measure"] in PART_MEASURES
        return place.rank(compute_file(mesh, parameters, policy, local=local), **options)
    ranking = place.rank(mesh, parameters=parameters, policy=policy, **options)
    if ranking.shapes:  # otherwise the caller says why there are none
        warn_of(mesh.name, ranking.warnings)
    return ranking


def cancel_job(place: Place, job_id: str) -> JobStatus:
    """Cancel a job and return its state; an ended job does not change. NotFoundError if there is no such job.

    In a library, this does not reach the server that may compute the job.
    """
    from unbend.client import Client  # noqa: PLC0415

    if isinstance(place, Client):
        return place.job(job_id).cancel()
    from unbend.errors import JobCancelledError  # noqa: PLC0415
    from unbend.jobs.failures import describe  # noqa: PLC0415

    _wait(place.jobs.get(job_id))
    place.jobs.cancel(job_id, describe(JobCancelledError("the job was cancelled")), None).result()
    return _wait(place.jobs.get(job_id)).status()


def _wait(reading: Coroutine[Any, Any, T]) -> T:
    import asyncio  # noqa: PLC0415

    return asyncio.run(reading)
