"""Retrieval metrics, compared with known results and with a plain implementation of their definitions."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.errors import ParameterError
from unbend.matching.evaluate import evaluate

METRICS = ("nn", "ft", "st", "e", "dcg", "map")


def separate(labels):
    """Return distances by which the classes are far from each other."""
    places = np.arange(len(labels))
    return np.abs(places[:, None] - places) + 1000.0 * np.not_equal.outer(labels, labels)


def leave_one_out(distances, labels):
    return evaluate(distances, labels, labels, own=np.arange(len(labels))).metrics


def ranked_at(ranks, count):
    """Evaluate one query of class "a" whose relevant shapes have these ranks among `count` shapes."""
    labels = ["a" if place in ranks else "b" for place in range(1, count + 1)]
    return evaluate(np.arange(1.0, count + 1)[None], ["a"], labels)


# --- known results


def test_metrics_of_a_perfect_ranking_are_one_except_e():
    labels = ["a"] * 40 + ["b"] * 40
    metrics = leave_one_out(separate(labels), labels)
    assert (metrics.nn, metrics.ft, metrics.st) == (1, 1, 1)
    assert (metrics.dcg, metrics.map) == (pytest.approx(1), pytest.approx(1))
    assert metrics.e == pytest.approx(2 / (1 + 39 / 32))  # the first 32 ranks have 32 of 39 members


def test_metrics_of_a_small_ranking_equal_hand_computed_values():
    # Query 0 ranks b, a, c, a: the other members of its class have ranks 2 and 4. All shapes are equally far from
    # queries 2 and 4, so they come in the order of the rows: a, b, c, a and a, b, a, c. The classes b and c
    # have one member, so their queries have no metrics.
    distances = np.full((5, 5), 9.0)
    distances[0] = [0, 1, 2, 3, 4]
    metrics = leave_one_out(distances, ["a", "b", "a", "c", "a"])
    gain = {1: 1.0, 2: 1.0, 3: 1 / np.log2(3), 4: 1 / np.log2(4)}
    assert metrics.nn == pytest.approx(np.mean([0, 1, 1]))
    assert metrics.ft == pytest.approx(np.mean([1 / 2, 1 / 2, 1 / 2]))
    assert metrics.st == pytest.approx(1.0)
    assert metrics.e == pytest.approx(2 / (32 / 2 + 1))
    assert metrics.dcg == pytest.approx(np.mean([gain[2] + gain[4], gain[1] + gain[4], gain[1] + gain[3]]) / 2)
    assert metrics.map == pytest.approx(np.mean([(1 / 2 + 2 / 4) / 2, (1 + 2 / 4) / 2, (1 + 2 / 3) / 2]))


def test_precision_and_recall_equal_those_of_the_documented_psbplot_example():
    # In psbPlot's example, the five other members of the class have ranks 1, 4, 10, 41 and 44.
    curve = ranked_at({1, 4, 10, 41, 44}, 60).precision_recall
    precision = dict(zip(np.round(curve.recall, 2).tolist(), curve.precision, strict=True))
    known = {0.2: 1.0, 0.4: 0.5, 0.6: 0.3, 0.8: 0.097561, 1.0: 0.113636}
    assert {recall: precision[recall] for recall in known} == pytest.approx(known, abs=1e-6)
    assert precision[0.3] == pytest.approx((1.0 + 0.5) / 2)
    assert precision[0.65] == pytest.approx(0.75 * 0.3 + 0.25 * 4 / 41)
    assert min(precision) == 0.2  # there is no precision below the recall of the first hit


def test_precision_at_low_recall_is_averaged_over_large_classes_only():
    # A query of "a" has three other members in its class, so its precision starts at recall 1/3. A query of "b" has
    # six, so its precision starts at recall 1/6.
    labels = ["a"] * 4 + ["b"] * 7
    distances = separate(labels)
    distances[:4] = 0.0  # all queries of "a" rank the shapes in the order of their rows
    distances[4:] = np.arange(11.0)  # all queries of "b" rank four of "a" first
    curve = evaluate(distances, labels, labels, own=np.arange(len(labels))).precision_recall
    assert curve.recall[0] == pytest.approx(0.2)
    first_of_b = 1 / 5
    second_of_b = 2 / 6
    assert curve.precision[0] == pytest.approx(0.8 * first_of_b + 0.2 * second_of_b)
    at_third = 0.9 * second_of_b + 0.1 * 3 / 7  # recall 0.35 of six is 2.1 members
    assert curve.precision[3] == pytest.approx((4 * 1.0 + 7 * at_third) / 11)


def test_an_evaluation_against_a_gallery_has_confusion_accuracy_and_wrong_answers():
    gallery = ["b", "a", "c"]
    distances = np.array([[2.0, 1.0, 3.0], [0.5, 1.0, 3.0], [1.0, 2.0, 0.25], [7.0, 8.0, 9.0]])
    found = evaluate(distances, ["a", "a", "c", "d"], gallery, unanswered=["a", "e"])
    assert found.labels == ("a", "b", "c", "d", "e")
    expected = np.zeros((5, 5))
    expected[0, 0] = expected[0, 1] = expected[2, 2] = expected[3, 1] = 1  # the gallery has no shape of "d"
    np.testing.assert_array_equal(found.confusion, expected)
    assert found.wrong.tolist() == [1, 3]
    assert (found.nearest.tolist(), found.nearest_distances.tolist()) == ([1, 0, 2, 0], [1.0, 0.5, 0.25, 7.0])
    assert (found.queries, found.unanswered, found.accuracy) == (6, 2, pytest.approx(2 / 6))
    assert found.metrics is not None
    assert found.metrics.nn == pytest.approx(2 / 3)  # the queries with metrics are of "a", "a" and "c"
    rows = {row.label: row for row in found.classes}
    assert [(row.queries, row.members) for row in rows.values()] == [(3, 1), (1, 1), (1, 0), (1, 0)]
    assert [row.accuracy for row in rows.values()] == [pytest.approx(1 / 3), 1.0, 0.0, 0.0]
    assert (rows["a"].metrics.nn, rows["c"].metrics.nn) == (0.5, 1.0)
    assert rows["d"].metrics is rows["e"].metrics is None


def test_every_answer_is_wrong_if_no_class_is_in_the_gallery():
    found = evaluate(np.ones((2, 1)), ["a", "b"], ["c"])
    assert (found.metrics, found.accuracy, found.precision_recall.recall) == (None, 0.0, ())
    assert all(found.as_dict()[name] is None for name in METRICS)
    nothing = evaluate(np.ones((0, 1)), [], ["c"], unanswered=["c"])
    assert (nothing.metrics, nothing.accuracy, nothing.queries) == (None, 0.0, 1)


def test_a_class_with_one_member_counts_as_wrong_and_has_no_metrics():
    labels = ["a", "a", "b"]
    found = evaluate(separate(labels), labels, labels, own=np.arange(3))
    assert found.metrics is not None
    assert found.metrics.nn == 1.0
    assert found.accuracy == pytest.approx(2 / 3)
    assert found.confusion.tolist() == [[2, 0], [1, 0]]
    assert (found.classes[1].members, found.classes[1].metrics) == (1, None)


def test_an_evaluation_is_one_json_object_that_contains_the_metrics():
    labels = ["b", "a", "a", "b", "c"]
    found = evaluate(separate(labels), labels, labels, own=np.arange(5))
    reported = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert reported == found.as_dict()
    assert {name: reported[name] for name in METRICS} == vars(leave_one_out(separate(labels), labels))
    lone = {"label": "c", "queries": 1, "members": 1, "accuracy": 0.0}
    assert reported["classes"][2] == lone | dict.fromkeys(METRICS)
    assert reported["confusion"] == {"labels": ["a", "b", "c"], "counts": found.confusion.tolist()}
    assert reported["precision_recall"] == {"recall": [1.0], "precision": [1.0]}


# --- comparison with the definitions


def oracle_metrics(relevant):
    """Return the metrics of a query by section 4.2 of the benchmark's paper; `relevant` has a boolean per rank."""
    size = sum(relevant)
    places = [place for place, hit in enumerate(relevant, 1) if hit]
    precision, recall = sum(relevant[:32]) / 32, sum(relevant[:32]) / size
    gains = [1.0 if place == 1 else 1 / np.log2(place) for place in range(1, len(relevant) + 1)]
    return (
        float(relevant[0]),
        sum(relevant[:size]) / size,
        sum(relevant[: 2 * size]) / size,
        2 / (1 / precision + 1 / recall) if precision else 0.0,
        sum(gains[place - 1] for place in places) / sum(gains[:size]),
        np.mean([hits / place for hits, place in enumerate(places, 1)]),
    )


def oracle_precision(relevant):
    """Return the precision at each twentieth of recall, starting at the recall of the first hit."""
    places = [place for place, hit in enumerate(relevant, 1) if hit]
    size = len(places)
    recall = [hits / size for hits in range(1, size + 1)]
    precision = [hits / place for hits, place in enumerate(places, 1)]
    return {level: np.interp(level / 20, recall, precision) for level in range(1, 21) if level * size >= 20}


def oracle(distances, queries, gallery, own):
    metrics, curves, nearest = [], [], []
    for query, label in enumerate(queries):
        rows = [row for row in range(len(gallery)) if own is None or row != own[query]]
        rows.sort(key=lambda row: (distances[query, row], row))
        nearest.append(rows[0])
        relevant = [gallery[row] == label for row in rows]
        if any(relevant):
            metrics.append((label, oracle_metrics(relevant)))
            curves.append(oracle_precision(relevant))
    return metrics, curves, nearest


@st.composite
def trials(draw):
    """Draw distances (many are equal), the classes of queries and gallery, and the rows of the queries or None."""
    gallery = draw(st.lists(st.sampled_from("abc"), min_size=2, max_size=70))
    rows = draw(st.lists(st.integers(0, len(gallery) - 1), min_size=1, max_size=9))
    left_out = draw(st.booleans())
    queries = [gallery[row] for row in rows] if left_out else draw(st.lists(st.sampled_from("abcd"), min_size=1))
    random = np.random.default_rng(draw(st.integers(0, 1000)))
    distances = random.integers(0, draw(st.sampled_from([1, 4, 1000])), (len(queries), len(gallery)))
    return distances.astype(draw(st.sampled_from([np.float32, float]))), queries, gallery, rows if left_out else None


@given(trials())
def test_every_metric_equals_the_mean_of_its_definition(trial):
    distances, queries, gallery, own = trial
    metrics, curves, nearest = oracle(*trial)
    given_own = None if own is None else np.array(own)
    if own is not None and not metrics:
        with pytest.raises(ParameterError, match="two members"):
            evaluate(distances, queries, gallery, own=given_own)
        return
    found = evaluate(distances, queries, gallery, own=given_own)
    assert found.nearest.tolist() == nearest
    right = [gallery[row] == label for row, label in zip(nearest, queries, strict=True)]
    assert found.accuracy == pytest.approx(np.mean(right))
    if metrics:
        assert list(vars(found.metrics).values()) == pytest.approx(np.mean([row for _, row in metrics], axis=0))
    else:
        assert found.metrics is None
    for row in found.classes:
        own_rows = [values for label, values in metrics if label == row.label]
        reported = None if row.metrics is None else list(vars(row.metrics).values())
        assert reported == (pytest.approx(np.mean(own_rows, axis=0)) if own_rows else None)
        assert (row.queries, row.members) == (queries.count(row.label), gallery.count(row.label))
    levels = [level for level in range(1, 21) if any(level in curve for curve in curves)]
    expected = [np.mean([curve[level] for curve in curves if level in curve]) for level in levels]
    assert found.precision_recall.recall == pytest.approx([level / 20 for level in levels])
    assert found.precision_recall.precision == pytest.approx(expected)
    for label, counts in zip(found.labels, found.confusion.tolist(), strict=True):
        answers = [gallery[row] for row, asked in zip(nearest, queries, strict=True) if asked == label]
        assert counts == [answers.count(other) for other in found.labels]


@given(trials(), st.integers(0, 100))
def test_metrics_depend_only_on_the_order_of_distances(trial, seed):
    distances, queries, gallery, _ = trial
    order = np.random.default_rng(seed).permutation(len(queries))
    one = evaluate(distances, queries, gallery)
    other = evaluate(7.0 + distances[order] ** 3, [queries[row] for row in order], gallery)
    assert other.nearest.tolist() == one.nearest[order].tolist()
    assert other.as_dict() == approximately(one.as_dict())


def approximately(value):
    if isinstance(value, dict):
        return {name: approximately(part) for name, part in value.items()}
    if isinstance(value, list):
        return [approximately(part) for part in value]
    return pytest.approx(value) if isinstance(value, float) else value


def test_metrics_of_parts_average_to_the_metrics_of_the_whole():
    # The queries of the large class are ranked in blocks, which differ between the whole and the parts.
    random = np.random.default_rng(5)
    labels = ["a"] * 1700 + ["b"] * 100
    points = random.normal(size=(1800, 2)) + np.repeat([[0.0], [0.5]], [1700, 100], axis=0)
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    rows = np.arange(1800)
    whole = evaluate(distances, labels, labels, own=rows)
    parts = [evaluate(distances[part], labels_of(part), labels, own=part) for part in np.split(rows, [37, 1111])]
    for name in METRICS:
        mean = np.average([getattr(part.metrics, name) for part in parts], weights=[37, 1074, 689])
        assert getattr(whole.metrics, name) == pytest.approx(mean)
    assert sum(part.confusion for part in parts).tolist() == whole.confusion.tolist()


def labels_of(rows):
    return ["a" if row < 1700 else "b" for row in rows]


def test_the_distance_from_a_query_to_itself_is_ignored():
    labels = ["a", "a", "b", "b"]
    distances = separate(labels)
    expected = leave_one_out(distances, labels)
    for other in (np.nan, -np.inf, np.inf, 0.5):
        np.fill_diagonal(distances, other)
        assert leave_one_out(distances, labels) == expected


def test_many_queries_together_are_faster_than_one_by_one():
    # 480 shapes in 30 classes, like SHREC'11. A loop over queries would take as long as single queries.
    labels = [f"class {row % 30}" for row in range(480)]
    points = np.random.default_rng(0).normal(size=(480, 5))
    distances = np.linalg.norm(points[:, None] - points, axis=2)

    def seconds(rows) -> float:
        start = time.perf_counter()
        evaluate(distances[rows], [labels[row] for row in rows], labels, own=rows)
        return time.perf_counter() - start

    together = min(seconds(np.arange(480)) for _ in range(20))
    alone = min(seconds(np.array([row])) for row in range(100))
    assert together < 480 * alone / 3


# --- errors


def test_an_evaluation_needs_a_class_of_two_members_and_matching_labels():
    with pytest.raises(ParameterError, match="two members"):
        leave_one_out(np.zeros((2, 2)), ["a", "b"])
    with pytest.raises(ParameterError, match="two members"):
        leave_one_out(np.empty((0, 0)), [])
    with pytest.raises(ParameterError, match="3 labels"):
        leave_one_out(np.zeros((2, 2)), ["a", "b", "c"])
    with pytest.raises(ParameterError, match="2 labels of the gallery"):
        evaluate(np.zeros((1, 3)), ["a"], ["a", "b"])


def test_an_evaluation_needs_queries_and_a_gallery():
    with pytest.raises(ParameterError, match="gallery is empty"):
        evaluate(np.empty((1, 0)), ["a"], [])
    with pytest.raises(ParameterError, match="no queries"):
        evaluate(np.empty((0, 1)), [], ["a"])


def test_a_nan_distance_is_refused_with_its_query():
    distances = separate(["a", "a", "b"])
    distances[1, 2] = np.nan
    with pytest.raises(ParameterError, match="query 1 is not a number"):
        leave_one_out(distances, ["a", "a", "b"])


@pytest.mark.parametrize("own", [[0], [0, 3], [-1, 1], [[0, 1]]], ids=["too few", "too large", "negative", "shape"])
def test_a_query_that_is_left_out_must_be_in_the_gallery(own):
    with pytest.raises(ParameterError, match=r"own must be a row of the gallery \(0 to 2\)"):
        evaluate(np.zeros((2, 3)), ["a", "a"], ["a", "a", "b"], own=np.array(own))


def test_a_query_that_is_left_out_must_be_of_one_class():
    with pytest.raises(ParameterError, match="query 1 has another class in the gallery"):
        evaluate(np.zeros((2, 3)), ["a", "a"], ["a", "a", "b"], own=np.array([0, 2]))
