"""Results as DataFrames: every table has the numbers of its result."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.support.server import ply
from unbend import Library, compute_signature
from unbend.errors import ParameterError
from unbend.frames import to_pandas
from unbend.matching.evaluate import evaluate
from unbend.mesh.shapes import cylinder, sheet, sphere, torus
from unbend.results import PartRelation

FEW = {"samples": 40}
PART = PartRelation("part", 0.5, 1.0, 0.0, 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
SHAPES = [
    ("flat", sheet(columns=12, rows=6), "sheet"),
    ("rolled", cylinder(columns=12, rows=6), "sheet"),
    ("ball", sphere(subdivisions=1), "sphere"),
    ("marble", sphere(subdivisions=2), "sphere"),
    ("ring", torus(columns=12, rows=8), None),
]


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A library, and the records of its shapes."""
    with Library(str(tmp_path_factory.mktemp("frames") / "library.db")) as library:
        yield (
            library,
            [
                library.add(
                    ply(surface), name=name, label=label, parameters=FEW, metadata={"faces": len(surface.faces)}
                )
                for name, surface, label in SHAPES
            ],
        )


def test_a_ranking_has_tables_of_shapes_and_of_classes(filled):
    library, _ = filled
    ranking = library.rank(compute_signature(SHAPES[0][1], FEW))
    shapes = to_pandas(ranking)
    assert list(shapes.columns) == ["id", "name", "label", "distance"]
    assert list(shapes.index) == [1, 2, 3, 4, 5]
    assert shapes.index.name == "rank"
    assert shapes["distance"].tolist() == [match.distance for match in ranking.shapes]
    assert shapes["label"].isna().sum() == 1
    classes = to_pandas(ranking, "classes")
    assert classes["label"].tolist() == [match.label for match in ranking.classes]
    assert classes.loc[1, "confidence"] == ranking.classes[0].confidence


def test_a_ranking_of_parts_says_what_the_query_is_to_each_shape(filled):
    library, records = filled
    ranking = library.rank(records[0].id)
    (match, *others) = ranking.shapes
    shapes = to_pandas(replace(ranking, shapes=[replace(match, part=PART), *others]))
    assert "part" not in shapes
    assert shapes.loc[1, "part.relation"] == "part"
    assert np.isnan(shapes.loc[2, "part.covered"])


def test_an_empty_ranking_keeps_its_columns(filled):
    library, records = filled
    empty = replace(library.rank(records[0].id), shapes=[], classes=[])
    assert list(to_pandas(empty).columns) == ["id", "name", "label", "distance"]
    assert list(to_pandas(empty, "classes").columns) == ["label", "distance", "confidence"]
    assert len(to_pandas(empty)) == 0


@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_map_has_the_coordinates_of_each_shape(filled, dimensions):
    library, records = filled
    found = library.map(parameters=records[0].parameters, dimensions=dimensions)
    frame = to_pandas(found)
    assert frame["name"].tolist() == [item.name for item in found.items]
    points = frame[[f"point{axis}" for axis in range(dimensions)]].to_numpy()
    assert points.tolist() == [list(item.point) for item in found.items]
    assert f"original{dimensions - 1}" in frame
    assert f"point{dimensions}" not in frame


def test_an_evaluation_has_three_tables(filled):
    library, records = filled
    found = library.evaluation(parameters=records[0].parameters)
    classes = to_pandas(found)
    assert classes["label"].tolist() == ["sheet", "sphere"]
    assert classes["nn"].tolist() == [row.metrics.nn for row in found.classes]
    confusion = to_pandas(found, "confusion")
    assert confusion.loc["sheet"].sum() == 2
    assert confusion.to_numpy().tolist() == [list(row) for row in found.confusion.counts]
    assert (confusion.index.name, confusion.columns.name) == ("label", "nearest")
    assert to_pandas(found, "precision_recall")["precision"].tolist() == list(found.precision_recall.precision)
    with pytest.raises(ParameterError, match="more than 1000 classes"):
        to_pandas(replace(found, confusion=None), "confusion")


def test_an_evaluation_of_distances_has_the_same_tables():
    found = evaluate(np.array([[0.1, 0.9], [0.8, 0.2]]), ["cat", "dog"], ["cat", "dog"])
    assert to_pandas(found)["label"].tolist() == ["cat", "dog"]
    assert to_pandas(found, "confusion").to_numpy().tolist() == [[1, 0], [0, 1]]


def test_records_have_a_column_for_each_field_and_each_key_of_their_metadata(filled):
    library, records = filled
    assert to_pandas(library)["id"].tolist() == to_pandas(iter(records))["id"].tolist()
    frame = to_pandas(records)
    assert frame["id"].tolist() == [record.id for record in records]
    assert frame["metadata.faces"].tolist() == [len(surface.faces) for _, surface, _ in SHAPES]
    assert frame["report.file_type"].tolist() == ["ply"] * len(records)
    assert frame["parameters"][0] == records[0].parameters
    (row,) = to_pandas(records[0]).to_dict(orient="records")  # of a single record, also of one that `add` returned
    assert (row["id"], row["report.file_type"]) == (records[0].id, "ply")
    assert frame.groupby("label")["area"].count().to_dict() == {"sheet": 2, "sphere": 2}
    assert len(to_pandas([])) == 0


@pytest.mark.parametrize("result", [3, "text", {"classes": []}, ["text"], None])
def test_anything_else_has_no_table(result):
    with pytest.raises(ParameterError, match=r"^result: \w+ (has no table|is no record)"):
        to_pandas(result)


def test_an_unknown_table_is_refused_with_the_names_of_the_others(filled):
    library, records = filled
    with pytest.raises(ParameterError, match="shapes, classes"):
        to_pandas(library.rank(records[0].id), "labels")
    assert json.loads(to_pandas(library.rank(records[0].id)).to_json(orient="records"))[0]["name"]
