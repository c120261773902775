"""What the queue's history must not keep of shapes that are gone: names, labels and metadata."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable
from itertools import islice
from typing import Any, Final

from sqlalchemy import Column, Connection, String, cast, or_, select, update

from unbend.library.schema import jobs, shapes

_BATCH: Final = 500
"""Values that one statement names."""


def forget_in_jobs(connection: Connection, shape_id: str, label: str | None, sha256: str) -> None:
    """Take a shape that was just removed out of all jobs that have ended.

    Parameters
    ----------
    connection : Connection
    shape_id : str
    label : str, optional
        Its class, which answers are to lose with its last member.
    sha256 : str
        Of its file: uploads of the same file that became no shape had something to say of this one.
    """
    ended = jobs.c.state.in_(("succeeded", "failed", "cancelled"))
    failed = (jobs.c.mesh_sha256 == sha256) & jobs.c.shape_id.is_(None) & (jobs.c.kind == "shape")
    became = or_(jobs.c.shape_id == shape_id, failed)
    connection.execute(update(jobs).where(ended, became).values(request={}, warnings=[]))
    told = cast(jobs.c.result, String)
    mention = told.contains(shape_id)
    if label is not None and label not in _present(connection, shapes.c.label, [label]):
        mention = or_(mention, told.contains(f'"label": {json.dumps(label)}', autoescape=True))
    seqs = connection.scalars(select(jobs.c.seq).where(jobs.c.state == "succeeded", mention)).all()
    for seq in seqs:
        result = connection.scalar(select(jobs.c.result).where(jobs.c.seq == seq))
        connection.execute(update(jobs).where(jobs.c.seq == seq).values(result=without_gone(connection, result)))


def without_gone(connection: Connection, ranking: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return a ranking without the shapes, and the classes, that the library does not have any more."""
    if ranking is None:
        return None
    ids = _present(connection, shapes.c.id, (match["id"] for match in ranking["shapes"]))
    labels = _present(connection, shapes.c.label, (match["label"] for match in ranking["classes"]))
    return ranking | {
        "shapes": [match for match in ranking["shapes"] if match["id"] in ids],
        "classes": [match for match in ranking["classes"] if match["label"] in labels],
    }


def _present(connection: Connection, column: Column[Any], values: Iterable[str]) -> Collection[str]:
    found: set[str] = set()
    rest = iter(values)
    while batch := list(islice(rest, _BATCH)):
        found.update(connection.scalars(select(column).where(column.in_(batch)).distinct()))
    return found
