"""Results as pandas DataFrames. Only this module imports pandas, which the extra `pandas` installs.

Results are recognised by their attributes and not by their types, so that a library and a client may have types of
their own, and so that this module needs neither a database nor a compiler.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Final

from unbend.errors import ParameterError, check_choice
from unbend.extras import extra

with extra("pandas"):
    from pandas import DataFrame, Index


def to_pandas(result: Any, table: str | None = None) -> DataFrame:
    """Return a table of a result as a DataFrame.

    Parameters
    ----------
    result : Ranking, ShapeMap, Evaluation, or iterable of records
        Records are dataclasses such as `ShapeRecord`; a library is an iterable of them.
    table : str, optional
        The first of these by default:

        - of a `Ranking`: "shapes", or "classes"; the index is the rank, from 1;
        - of a `ShapeMap`: "shapes", with the coordinates `point0`, `point1` ... and `original0`, `original1` ...;
        - of an `Evaluation`: "classes" (metrics of each class), "confusion" (counts of queries by their class, in rows,
          and the class of the nearest shape, in columns), "precision_recall", or "queries" (each with its nearest
          shape);
        - of records: "records", a column for each field. A field that is a mapping, such as `metadata`, has a column
          for each key, such as `metadata.artist`.

    Raises
    ------
    ParameterError
        If `result` is none of these, or has no such table.

    Examples
    --------
    >>> from unbend.matching.evaluate import evaluate
    >>> import numpy as np
    >>> found = evaluate(np.array([[0.1, 0.9], [0.8, 0.2]]), ["cat", "dog"], ["cat", "dog"])
    >>> to_pandas(found, "confusion")
    nearest  cat  dog
    label
    cat        1    0
    dog        0    1
    """
    tables = _tables(result)
    name = next(iter(tables)) if table is None else table
    check_choice("table", name, tables)
    return tables[name](result)


def _tables(result: Any) -> Mapping[str, Callable[[Any], DataFrame]]:
    for attributes, tables in _KINDS.items():
        if all(hasattr(result, attribute) for attribute in attributes):
            return tables
    if isinstance(result, Iterable) and not isinstance(result, str | bytes | Mapping):
        return {"records": _records}
    raise ParameterError(
        f"result: {type(result).__name__} has no table; give a Ranking, a ShapeMap, an Evaluation, or records"
    )


def _frame(rows: Sequence[Mapping[str, Any]], *columns: str) -> DataFrame:
    """Return a DataFrame of rows; without any row it still has `columns`."""
    return DataFrame(list(rows), columns=None if rows else list(columns))


def _records(records: Iterable[Any]) -> DataFrame:
    return _frame([_row(record) for record in records])


def _row(record: Any) -> dict[str, Any]:
    if not is_dataclass(record):
        raise ParameterError(f"result: {type(record).__name__} is no record")
    row: dict[str, Any] = {}
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, Mapping):
            row |= {f"{field.name}.{key}": part for key, part in value.items()}
        else:
            row[field.name] = value
    return row


def _ranked(matches: Iterable[Any], *columns: str) -> DataFrame:
    frame = _frame([_row(match) for match in matches], *columns)
    frame.index = frame.index + 1
    return frame.rename_axis(index="rank")


def _ranked_shapes(ranking: Any) -> DataFrame:
    frame = _ranked(ranking.shapes, "id", "name", "label", "distance")
    # Only measures of parts fill `part`, and then its keys are columns of their own.
    return frame.drop(columns="part", errors="ignore")


def _ranked_classes(ranking: Any) -> DataFrame:
    return _ranked(ranking.classes, "label", "distance", "confidence")


def _places(shape_map: Any) -> DataFrame:
    rows = []
    for item in shape_map.items:
        row = {"id": item.id, "name": item.name, "label": item.label}
        for which in ("point", "original"):
            row |= {f"{which}{axis}": value for axis, value in enumerate(getattr(item, which))}
        rows.append(row)
    return _frame(rows, "id", "name", "label")


def _class_metrics(evaluation: Any) -> DataFrame:
    return _frame([row.as_dict() for row in evaluation.classes])


def _confusion(evaluation: Any) -> DataFrame:
    labels = list(evaluation.labels)
    return DataFrame(evaluation.confusion, index=Index(labels, name="label"), columns=Index(labels, name="nearest"))


def _precision_recall(evaluation: Any) -> DataFrame:
    found = evaluation.precision_recall
    return DataFrame({"recall": list(found.recall), "precision": list(found.precision)})


def _queries(evaluation: Any) -> DataFrame:
    labels = evaluation.labels
    return DataFrame(
        {
            "label": [labels[code] for code in evaluation.query_classes],
            "nearest_label": [labels[code] for code in evaluation.nearest_classes],
            "nearest": evaluation.nearest,
            "distance": evaluation.nearest_distances,
        }
    )


_KINDS: Final[Mapping[tuple[str, ...], Mapping[str, Callable[[Any], DataFrame]]]] = {
    ("shapes", "classes"): {"shapes": _ranked_shapes, "classes": _ranked_classes},
    ("confusion", "precision_recall"): {
        "classes": _class_metrics, "confusion": _confusion, "precision_recall": _precision_recall, "queries": _queries,
    },
    ("items", "stress"): {"shapes": _places},
}  # fmt: skip
"""The tables of each kind of result, the default first, by attributes that only this kind has."""
