"""Classification: known results of each classifier, and properties of all classifiers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.errors import ParameterError
from unbend.matching.classification import CLASSIFIERS, DEFAULT_CLASSIFIER, classify, get_classifier
from unbend.matching.gallery import UNLABELLED, Gallery
from unbend.matching.measures import get_vector_measure

MEASURE = get_vector_measure("moments")
seeds = st.integers(0, 2**32 - 1)
names = st.sampled_from(list(CLASSIFIERS))


def on_a_line(*members):
    """Return a gallery of points on a line, from pairs (place, label)."""
    return Gallery.of(np.array([[place] for place, _ in members], np.float32), [label for _, label in members])


def labels_and_distances(answer):
    return [(match.label, pytest.approx(match.distance)) for match in answer.matches]


LINE = on_a_line((0, "a"), (1, "a"), (4, "b"), (5, "b"), (6, "b"), (2.4, None))


def test_nearest_uses_the_distance_of_the_nearest_member(ask):
    assert labels_and_distances(ask(LINE, 2.4)) == [("a", 1.4), ("b", 1.6)]
    assert labels_and_distances(ask(LINE, 3.0)) == [("b", 1.0), ("a", 2.0)]


def test_vote_lets_two_neighbours_outvote_a_nearer_one(ask):
    gallery = on_a_line((-1.0, "a"), (1.2, "b"), (1.3, "b"), (9.0, "c"))
    assert labels_and_distances(ask(gallery, 0.0, "nearest"))[0] == ("a", 1.0)
    assert labels_and_distances(ask(gallery, 0.0, "vote")) == [("b", pytest.approx(1.2)), ("a", 1.0), ("c", 9.0)]
    far = on_a_line((-1.0, "a"), (2.2, "b"), (2.3, "b"))
    assert labels_and_distances(ask(far, 0.0, "vote"))[0] == ("a", 1.0)  # 1 / 2.2 + 1 / 2.3 is less than 1


def test_vote_includes_all_neighbours_as_near_as_the_third(ask):
    members = [(-1.0, "a"), (1.9, "c"), (2.0, "b"), (-2.0, "b"), (2.0, "b")]
    for order in (members, members[::-1]):
        assert labels_and_distances(ask(on_a_line(*order), 0.0, "vote"))[0] == ("b", 2.0)


def test_mean_uses_the_distance_to_the_mean_of_the_class(ask):
    assert labels_and_distances(ask(LINE, 2.4, "mean")) == [("a", 1.9), ("b", 2.6)]


def test_discriminants_prefer_axes_along_which_members_agree(ask):
    # Members vary along the first axis; classes also differ along the second axis.
    random = np.random.default_rng(0)
    members = random.normal(size=(120, 2)) * (15.0, 0.1) + np.repeat([(0.0, 0.0), (30.0, 10.0)], 60, axis=0)
    gallery = Gallery.of(members.astype(np.float32), ["low"] * 60 + ["high"] * 60)
    assert ask(gallery, [28.0, 2.0], "mean").matches[0].label == "high"
    assert ask(gallery, [28.0, 2.0], "discriminants").matches[0].label == "low"


@pytest.mark.parametrize("classifier", CLASSIFIERS)
def test_there_is_one_match_for_each_class_with_members(ask, clouds, classifier):
    gallery = clouds(1, classes=4, unlabelled=3)
    empty = Gallery(gallery.vectors, np.where(gallery.codes == 2, UNLABELLED, gallery.codes), gallery.labels)
    answer = ask(empty, gallery.vectors[0], classifier)
    assert {match.label for match in answer.matches} == set(gallery.labels) - {gallery.labels[2]}
    assert sum(match.confidence for match in answer.matches) == pytest.approx(1.0)
    confidences = [match.confidence for match in answer.matches]
    assert confidences == sorted(confidences, reverse=True)


@pytest.mark.parametrize("classifier", ["nearest", "vote", "mean"])
def test_no_labels_give_no_matches_and_a_single_class_has_confidence_one(ask, classifier):
    none = ask(on_a_line((0, None), (1, None)), 0.5, classifier)
    assert (none.matches, none.known) == ([], None)
    (only,) = ask(on_a_line((0, "a"), (1, None)), 0.5, classifier).matches
    assert (only.label, only.distance, only.confidence) == ("a", 0.5, 1.0)


@pytest.mark.parametrize("classifier", ["nearest", "vote", "mean"])
def test_equally_near_classes_are_sorted_by_label_with_equal_confidence(ask, classifier):
    for gallery in (on_a_line((1, "b"), (-1, "a")), on_a_line((-1, "a"), (1, "b"))):
        answer = ask(gallery, 0.0, classifier)
        assert labels_and_distances(answer) == [("a", 1.0), ("b", 1.0)]
        assert [match.confidence for match in answer.matches] == [0.5, 0.5]
    twins = ask(on_a_line((0, "b"), (0, "a"), (1, "c")), 0.0, classifier)
    assert [match.confidence for match in twins.matches] == pytest.approx([0.5, 0.5, 0.0])


@given(seeds, names, st.integers(0, 4))
def test_answers_do_not_depend_on_the_order_of_shapes_or_classes(ask, clouds, seed, classifier, unlabelled):
    gallery = clouds(seed, unlabelled=unlabelled)
    random = np.random.default_rng(seed)
    order, query = random.permutation(len(gallery)), random.normal(size=4)
    labels = [gallery.label(row) for row in order]
    here, there = ask(gallery, query, classifier), ask(Gallery.of(gallery.vectors[order], labels), query, classifier)
    assert [match.label for match in here.matches] == [match.label for match in there.matches]
    assert here.known == there.known
    for one, other in zip(here.matches, there.matches, strict=True):
        assert (one.distance, one.confidence) == pytest.approx((other.distance, other.confidence), rel=1e-5, abs=1e-9)


@given(seeds, names, st.integers(1, 4))
def test_leaving_rows_out_equals_a_gallery_without_them(ask, clouds, seed, classifier, count):
    gallery = clouds(seed, members=5)
    random = np.random.default_rng(seed)
    gone, query = random.permutation(len(gallery))[:count], random.normal(size=4)
    rest = np.setdiff1d(np.arange(len(gallery)), gone)
    labels = [gallery.label(row) for row in rest]
    here, there = (
        ask(gallery, query, classifier, gone),
        ask(Gallery.of(gallery.vectors[rest], labels), query, classifier),
    )
    assert [match.label for match in here.matches] == [match.label for match in there.matches]
    assert here.known == there.known
    for one, other in zip(here.matches, there.matches, strict=True):
        assert (one.distance, one.confidence) == pytest.approx((other.distance, other.confidence), rel=1e-4, abs=1e-7)


@pytest.mark.parametrize("classifier", CLASSIFIERS)
def test_a_class_whose_last_member_is_left_out_is_not_answered(ask, clouds, classifier):
    gallery = clouds(3)
    row = int(np.flatnonzero(gallery.codes == 1)[0])
    lone = Gallery(gallery.vectors, np.where(gallery.codes == 1, UNLABELLED, gallery.codes), gallery.labels)
    lone.codes[row] = 1
    assert gallery.labels[1] in {match.label for match in ask(lone, gallery.vectors[0], classifier).matches}
    answer = ask(lone, gallery.vectors[row], classifier, [row])
    assert {match.label for match in answer.matches} == {gallery.labels[0], gallery.labels[2]}


def test_an_unknown_classifier_is_refused_with_the_known_ones(ask):
    with pytest.raises(ParameterError, match="nearest, vote, mean, discriminants, not 'oracle'"):
        get_classifier("oracle")
    with pytest.raises(ParameterError, match="oracle"):
        ask(LINE, 0.0, "oracle")
    assert get_classifier(DEFAULT_CLASSIFIER).name == DEFAULT_CLASSIFIER


def test_distances_must_match_the_rows_of_the_gallery():
    with pytest.raises(ParameterError, match=r"shape \(5,\) for a gallery of 6"):
        classify(LINE, MEASURE, np.zeros(1, np.float32), np.zeros(5))


CLASSES, MEMBERS = 7, 5


def test_real_shapes_are_classified_correctly_and_other_classes_are_unknown(labelled):
    from unbend import Parameters, compute_signature, read_mesh
    from unbend.matching.measures import DEFAULT_MEASURE

    measure = get_vector_measure(DEFAULT_MEASURE)
    shapes = labelled("shrec11_simplified")
    classes = sorted({row["class"] for _, row in shapes})[:: 30 // CLASSES][:CLASSES]
    paths = [path for label in classes for path in [path for path, row in shapes if row["class"] == label][:MEMBERS]]
    signatures = [compute_signature(read_mesh(path), Parameters(samples=120), threads=1) for path in paths]
    vectors = np.stack([measure.vector(signature.descriptors) for signature in signatures])
    gallery = Gallery.of(vectors, np.repeat(classes, MEMBERS).tolist())
    for classifier in CLASSIFIERS:
        known, strange = [], []
        for row, vector in enumerate(vectors):
            distances = measure.distances(vector, vectors)
            distances[row] = np.inf
            answer = classify(gallery, measure, vector, distances, classifier)
            assert answer.matches[0].label == gallery.label(row), (classifier, row)
            known.append(answer.known)
            distances[gallery.codes == gallery.codes[row]] = np.inf
            strange.append(classify(gallery, measure, vector, distances, classifier).known)
        assert np.mean(known) > 0.85, classifier
        assert np.mean(strange) < 0.15, classifier
