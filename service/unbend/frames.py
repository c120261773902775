"""Results as pandas DataFrames. Only this module imports pandas, which the extra `pandas` installs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Final

from unbend.errors import ParameterError, check_choice
from unbend.extras import extra
from unbend.matching.evaluate import Evaluation, EvaluationSummary
from unbend.results import Ranking, ShapeMap, ShapeRecord

with extra("pandas"):
    from pandas import DataFrame, Index


def to_pandas(result: Any, table: str | None = None) -> DataFrame:
    """Return a table of a result as a DataFrame.

    Parameters
    ----------
    result : Ranking, ShapeMap, EvaluationResult, Evaluation, record, or iterable of records
        Records are dataclasses such as `ShapeRecord`; a library and a client are iterables of them.
    table : str, optional
        The first of these by default:

        - of a `Ranking`: "shapes", or "classes"; the index is the rank, from 1;
        - of a `ShapeMap`: "shapes", with the coordinates `point0`, `point1` ... and `original0`, `original1` ...;
        - of an evaluation: "classes" (metrics of each class), "confusion" (counts of queries by their class, in rows,
          and the class of the nearest shape, in columns), or "precision_recall";
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
    if isinstance(result, Evaluation):
        result = result.summary
    tables = _tables_of(result)
    name = next(iter(tables)) if table is None else table
    check_choice("table", name, tables)
    return tables[name](result)


def _tables_of(result: Any) -> Mapping[str, Callable[[Any], DataFrame]]:
    for kind, tables in _TABLES.items():
        if isinstance(result, kind):
            return tables
    if isinstance(result, Iterable) and not isinstance(result, str | bytes | Mapping):
        return {"records": _records}
    if isinstance(result, ShapeRecord):
        return {"records": lambda record: _records([record])}
    raise ParameterError(
        f"result: {type(result).__name__} has no table; give a Ranking, a ShapeMap, an evaluation, or records"
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
        row |= _parts(field.name, value) if isinstance(value, Mapping) else {field.name: value}
    return row


def _parts(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{name}.{key}": value for key, value in values.items()}


def _ranked(rows: Sequence[Mapping[str, Any]], *columns: str) -> DataFrame:
    frame = _frame(rows, *columns)
    frame.index = frame.index + 1
    return frame.rename_axis(index="rank")


def _ranked_shapes(ranking: Ranking) -> DataFrame:
    rows = []
    for match in ranking.shapes:
        row = _row(match)
        part = row.pop("part")  # only measures of parts have it
        rows.append(row | (_parts("part", vars(part)) if part else {}))
    return _ranked(rows, "id", "name", "label", "distance")


def _ranked_classes(ranking: Ranking) -> DataFrame:
    return _ranked([_row(match) for match in ranking.classes], "label", "distance", "confidence")


def _places(shape_map: ShapeMap) -> DataFrame:
    rows = []
    for item in shape_map.items:
        row = _row(item)
        for which in ("point", "original"):
            row |= {f"{which}{axis}": value for axis, value in enumerate(row.pop(which))}
        rows.append(row)
    return _frame(rows, "id", "name", "label")


def _class_metrics(evaluation: EvaluationSummary) -> DataFrame:
    return _frame([row.as_dict() for row in evaluation.classes])


def _confusion(evaluation: EvaluationSummary) -> DataFrame:
    found = evaluation.confusion
    if found is None:
        raise ParameterError("table: evaluations of more than 1000 classes have no confusion matrix")
    labels = list(found.labels)
    return DataFrame(list(found.counts), index=Index(labels, name="label"), columns=Index(labels, name="nearest"))


def _precision_recall(evaluation: EvaluationSummary) -> DataFrame:
    found = evaluation.precision_recall
    return DataFrame({"recall": list(found.recall), "precision": list(found.precision)})


_TABLES: Final[Mapping[type, Mapping[str, Callable[[Any], DataFrame]]]] = {
    Ranking: {"shapes": _ranked_shapes, "classes": _ranked_classes},
    ShapeMap: {"shapes": _places},
    EvaluationSummary: {
        "classes": _class_metrics, "confusion": _confusion, "precision_recall": _precision_recall,
    },
}  # fmt: skip
"""The tables of each kind of result, the default first."""
