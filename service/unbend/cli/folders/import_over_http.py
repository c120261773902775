"""The import of files into a running service."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator
from functools import partial
from typing import Final

from unbend.cli.folders.account import Ended
from unbend.cli.folders.files import LabelledFile
from unbend.cli.folders.first_paths import FirstPaths
from unbend.cli.folders.import_options import ImportOptions, description_of, kept_class
from unbend.cli.places import connect
from unbend.client import Client, Job
from unbend.errors import AccessError, ServiceError, UnbendError
from unbend.results.shapes import AddedShape

_AHEAD: Final = 64
"""Most uploads whose shapes are waited for, enough that no worker of the service is idle."""


def import_over_http(url: str, files: Iterator[LabelledFile], options: ImportOptions) -> Generator[Ended]:
    """Upload files, and yield each once the service has stored its shape.

    Raises
    ------
    ParameterError
        If options are invalid.
    ServiceError, AccessError
        If the service does not respond, or refuses the key: it would do so for every file.
    """
    options.check()
    with connect(url) as client, FirstPaths() as firsts:
        waiting: deque[tuple[LabelledFile, Job[AddedShape]]] = deque()
        for file in files:
            try:
                waiting.append((file, _submit(client, file, firsts, options)))
            except (ServiceError, AccessError):
                raise
            except (UnbendError, OSError) as error:
                yield Ended(file.path, "failed", str(error))
            if len(waiting) > _AHEAD:
                yield _ended(*waiting.popleft(), firsts)
        for file, job in waiting:
            yield _ended(file, job, firsts)


def _submit(client: Client, file: LabelledFile, firsts: FirstPaths, options: ImportOptions) -> Job[AddedShape]:
    _, content = options.content_of(file)
    return client.submit(
        file.path,
        **description_of(file),
        parameters=options.parameters_of(file),
        policy=options.policy_of(file),
        if_known=options.if_known_of(firsts.put(content, file.path)),
    )


def _ended(file: LabelledFile, job: Job[AddedShape], firsts: FirstPaths) -> Ended:
    try:
        shape = job.result()
    except (ServiceError, AccessError):
        raise
    except UnbendError as error:
        return Ended(file.path, "failed", str(error))
    ended = partial(Ended, file.path, result=shape.id, taken=shape.updated, warnings=shape.warnings)
    if first := firsts.put(shape.id.encode(), file.path):
        # A service reports no ignored fields of a file that it computed at the same time as the first.
        ignored = [field for field, value in description_of(file).items() if getattr(shape, field) != value]
        return ended("merged", str(first), ignored=ignored)
    if shape.is_new:
        return ended("new")
    return ended("changed" if shape.updated else "unchanged", kept_class(file, shape), ignored=shape.ignored)
