"""Rankings of query jobs, stored as references to shapes and classes.

A stored ranking contains the seq and distance of each shape. Under a measure of parts it also contains how the query
relates to each shape. For each class it contains the row in `labels`, the distance and the confidence. Reading a
ranking fills in names and labels. A removed shape or class therefore disappears from all rankings without a search
through history.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from types import UnionType
from typing import Any, Final, TypeVar

from sqlalchemy import Column, Connection, Row, Select, delete, insert, select

from unbend.library.storage.log_eraser import mark_erased
from unbend.library.storage.schema import labels, shapes

T = TypeVar("T")

_BATCH: Final = 500
"""Largest number of values in one statement."""

_PACKED: Final[dict[str, Sequence[Sequence[type | UnionType]]]] = {
    "shapes": ((int, int | float), (int, int | float, dict)),
    "classes": ((int, int | float, int | float),),
}
"""Types in the stored form of each match; the third of a shape is how the query relates to it."""


def pack_ranking(connection: Connection, ranking: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the stored form of a ranking, without shapes and classes that the library no longer has."""
    if ranking is None:
        return None
    seqs = {row.id: row.seq for row in _rows(connection, shapes.c.id, (each["id"] for each in ranking["shapes"]))}
    rows = _label_rows(connection, [each["label"] for each in ranking["classes"]])
    return ranking | {
        "shapes": [
            [seqs[each["id"]], each["distance"], *([each["part"]] if each.get("part") else [])]
            for each in ranking["shapes"]
            if each["id"] in seqs
        ],
        "classes": [
            [rows[each["label"]], each["distance"], each["confidence"]]
            for each in ranking["classes"]
            if each["label"] in rows
        ],
    }


def unpack_ranking(connection: Connection, stored: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return a stored ranking with the present names and labels of its shapes."""
    if stored is None:
        return None
    found = {row.seq: row for row in _rows(connection, shapes.c.seq, (seq for seq, *_ in stored["shapes"]))}
    texts = _texts(connection, (row for row, _, _ in stored["classes"]))
    return stored | {
        "shapes": [
            {
                "id": row.id,
                "name": row.name,
                "label": row.label,
                "distance": distance,
                "part": part[0] if part else None,
            }
            for seq, distance, *part in stored["shapes"]
            if (row := found.get(seq))
        ],
        "classes": [
            {"label": texts[row], "distance": distance, "confidence": confidence}
            for row, distance, confidence in stored["classes"]
            if row in texts
        ],
    }


def is_packed(stored: Any) -> bool:
    """Return whether a value is None or has the form that `pack_ranking` returns."""
    if stored is None:
        return True
    return isinstance(stored, dict) and all(
        isinstance(stored.get(part), list) and all(any(_fits(each, kinds) for kinds in forms) for each in stored[part])
        for part, forms in _PACKED.items()
    )


def _fits(value: Any, kinds: Sequence[type | UnionType]) -> bool:
    return isinstance(value, list) and len(value) == len(kinds) and all(map(isinstance, value, kinds))


def delete_unused_label(connection: Connection, label: str | None) -> None:
    """Delete a class from all rankings if it has no members any more."""
    if label is not None and connection.scalar(select(shapes.c.seq).where(shapes.c.label == label).limit(1)) is None:
        connection.execute(delete(labels).where(labels.c.text == label))
        mark_erased(connection, "now")


def _label_rows(connection: Connection, texts: list[str]) -> dict[str, int]:
    """Return the row of each label that has members; missing rows are inserted."""
    present = {
        text
        for batch in _batches(texts)
        for text in connection.scalars(select(shapes.c.label).where(shapes.c.label.in_(batch)).distinct())
    }
    known = {
        text: row
        for batch in _batches(present)
        for row, text in connection.execute(select(labels.c.id, labels.c.text).where(labels.c.text.in_(batch)))
    }
    for text in sorted(present - set(known)):
        known[text] = connection.scalars(insert(labels).values(text=text).returning(labels.c.id)).one()
    return known


def _texts(connection: Connection, rows: Iterable[int]) -> dict[int, str]:
    named = select(labels.c.id, labels.c.text)
    return {
        row.id: row.text for batch in _batches(rows) for row in connection.execute(named.where(labels.c.id.in_(batch)))
    }


def _rows(connection: Connection, column: Column[Any], values: Iterable[Any]) -> Iterator[Row[Any]]:
    wanted: Select[Any] = select(shapes.c.seq, shapes.c.id, shapes.c.name, shapes.c.label)
    for batch in _batches(values):
        yield from connection.execute(wanted.where(column.in_(batch)))


def _batches(values: Iterable[T]) -> Iterator[list[T]]:
    rest = iter(values)
    while batch := list(islice(rest, _BATCH)):
        yield batch
