"""Every public value has a short `repr`: one line of facts, without arrays."""

from __future__ import annotations

from dataclasses import is_dataclass

import numpy as np
import pytest

import unbend
from unbend import results
from unbend.library.storage.database import shown_url
from unbend.matching.class_map import class_map
from unbend.matching.evaluate import evaluate
from unbend.matching.measures import get_vector_measure
from unbend.mesh.shapes import cylinder, ellipsoid, sheet, torus

LONGEST = 250  # characters, if names are short: a few lines of a narrow terminal


@pytest.fixture(scope="module")
def values(tmp_path_factory) -> dict[str, object]:
    surface = cylinder()
    signature = unbend.compute_signature(surface, {"samples": 30, "method": "classical"})
    body = ellipsoid((1.0, 0.7, 0.4))
    locals_ = unbend.local_signatures(surface, centres=20)
    comparison = unbend.compare_parts(locals_, locals_)
    with unbend.Library(str(tmp_path_factory.mktemp("brief") / "library.db")) as library:
        few = {"samples": 30}
        members = [(cylinder, "tube"), (sheet, "tube"), (torus, "ring")]
        added = [library.add(shape(columns=12, rows=6), label=label, parameters=few) for shape, label in members]
        ranking, shape_map = library.rank(added[0].id), library.map(parameters=few)
        evaluation, page = library.evaluation(parameters=few), library.page()
    vectors = np.random.default_rng(0).normal(size=(5, 14)).astype(np.float32)
    return {
        "surface": surface,
        "report": unbend.read_mesh((surface.vertices, surface.faces)).report,
        "edges": surface.edges,
        "signature": signature,
        "form": unbend.canonical_form(surface, signature=signature),
        "flattening": unbend.flatten(surface, unbend.Parameters(samples=30)),
        "embedding": unbend.embed(np.abs(np.subtract.outer(np.arange(9.0), np.arange(9.0))), 1),
        "diagram": unbend.geodesic_voronoi(surface, [0, 7]),
        "locals": locals_,
        "comparison": comparison,
        "correspondence": unbend.symmetry(body, samples=30),
        "map": class_map(vectors, get_vector_measure("moments")),
        "evaluation": evaluate(np.array([[0.0, 1.0, 2.0]]), ["cat"], ["cat", "dog", "dog"], unanswered=["dog"]),
        "added": added[0],
        "record": page.items[0],
        "page": page,
        "ranking": ranking,
        "class": ranking.classes[0],
        "match": ranking.shapes[0],
        "part": results.PartRelation.of(comparison),
        "shapes": shape_map,
        "item": shape_map.items[0],
        "result": evaluation,
        "metrics of a class": evaluation.classes[0],
        "metrics": evaluation.metrics,
        "confusion": evaluation.confusion,
        "precision": evaluation.precision_recall,
        "points": results.PointMap(np.zeros((9, 3)), np.ones((9, 3)) / 3, np.ones(9), 0.0, True, False),
        "failure": results.JobFailure("job_timeout", "it took too long"),
        "job": results.JobStatus("0123456789abcdef", "query", "succeeded", result=ranking),
        "parameters": unbend.Parameters(samples=30, weights="area"),
        "policy": unbend.MeshPolicy(smooth=3),
        "picture": unbend.PictureRequest(path=(0, 3), width=64),
    }


def test_every_repr_is_one_short_line(values):
    for value in values.values():
        text = repr(value)
        assert text.startswith(f"{type(value).__name__}(")
        assert len(text) <= LONGEST, text
        assert "\n" not in text
        assert "array" not in text


def test_every_public_type_of_values_is_among_them(values):
    names = [(module, name) for module in (unbend, results) for name in module.__all__]
    public = {kind for module, name in names if is_dataclass(kind := getattr(module, name))}
    assert public <= {type(value) for value in values.values()}


def test_a_signature_says_how_it_was_made(values):
    signature = values["signature"]
    assert repr(signature) == (
        f"Signature(30 points in 3 dimensions, stress {signature.stress:.3g}, samples=30, method='classical', "
        f"version {signature.version})"
    )


def test_things_are_counted(values):
    surface = values["surface"]
    assert repr(surface) == f"Surface({len(surface.vertices)} vertices, {len(surface.faces)} faces)"
    assert repr(unbend.Surface(np.eye(3), [[0, 1, 2]])) == "Surface(3 vertices, 1 face)"
    assert "2 cells" in repr(values["diagram"])
    assert "9 points in 1 dimension," in repr(values["embedding"])
    assert repr(values["evaluation"]).startswith("Evaluation(2 queries, 2 classes, accuracy 0.5, ")


def test_a_ranking_says_what_is_best(values):
    assert repr(values["ranking"]).startswith("Ranking(spectrum, best class 'tube', ")
    assert repr(values["ranking"]).endswith("2 shapes, 2 classes)")
    assert repr(values["shapes"]).startswith("ShapeMap(spectrum, 3 of 3 shapes, stress ")
    assert repr(values["result"]).startswith("EvaluationResult(spectrum, 3 queries, 2 classes, accuracy ")
    assert "label='tube'" in repr(values["added"])
    assert repr(values["page"]) == "ShapePage(3 shapes)"
    assert repr(values["points"]) == "PointMap(9 of 9 vertices matched, residual 0, oriented)"


def test_the_repr_of_parameters_has_what_is_not_default_and_can_be_evaluated(values):
    assert repr(unbend.Parameters()) == "Parameters()"
    for name in ("parameters", "policy", "picture"):
        assert eval(repr(values[name]), vars(unbend)) == values[name]  # noqa: S307


def test_a_report_counts_its_sentences():
    two = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 0, 0], [10, 0, 0], [9, 1, 0]])
    surface = unbend.read_mesh((two, [[0, 1, 2], [3, 4, 5]]))
    assert "components=2" in repr(surface.report)
    assert "1 warning" in repr(surface.report)
    assert repr(surface).endswith(", 1 warning)")


def test_libraries_and_clients_name_their_place_and_never_fail(tmp_path):
    path = str(tmp_path / "mine.db")
    with unbend.Library(path) as library:
        library.add(torus(columns=12, rows=6), label="ring", parameters={"samples": 30})
        assert repr(library) == f"Library({path!r}, 1 shape, 1 class)"
    assert repr(library) == f"Library({path!r}, closed)"
    with unbend.Client("http://me:secret@127.0.0.1:9") as client:
        assert repr(client) == "Client('http://127.0.0.1:9')"  # without a request
    assert repr(client) == "Client('http://127.0.0.1:9', closed)"


def test_an_address_is_shown_without_its_password():
    assert shown_url("postgresql+psycopg://me:secret@host/shapes") == "postgresql+psycopg://me:***@host/shapes"
    assert shown_url("/home/me/shapes.db") == "/home/me/shapes.db"
