"""Confidences from the nearest shapes and from samples of the other classes."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.matching.classification import SAMPLE, ClassSamples, classify
from unbend.matching.classification.calibration import calibration_of
from unbend.matching.gallery import Gallery
from unbend.matching.measures.vectors import SPECTRUM
from unbend.matching.selection import smallest

EXPONENT = calibration_of("spectrum").exponents["nearest"]


def drawn(sizes, seed=0, width=20):
    """Return vectors in classes of these sizes, and their classes, in order."""
    random = np.random.default_rng(seed)
    codes = np.repeat(np.arange(len(sizes)), sizes)
    centres = 0.5 * random.normal(size=(len(sizes), width))
    return (centres[codes] + random.normal(size=(len(codes), width))).astype(np.float32), codes


def samples_of(vectors, codes, sizes):
    chosen = np.concatenate([np.flatnonzero(codes == code)[:SAMPLE] for code in range(len(sizes))])
    return ClassSamples(tuple(f"class {code}" for code in range(len(sizes))), np.array(sizes), vectors[chosen])


def both(sizes, query, candidates=150):
    """Return the classification by all vectors, and that by the nearest ones and samples."""
    vectors, codes = drawn(sizes)
    labels = [f"class {code}" for code in codes]
    distances = SPECTRUM.distances(query, vectors)
    full = classify(Gallery.of(vectors, labels), SPECTRUM, query, distances)
    near = smallest(distances, candidates)
    gallery = Gallery.of(vectors[near], [labels[row] for row in near])
    absent = samples_of(vectors, codes, sizes).absent(
        query, SPECTRUM, set(gallery.labels), float(distances[near[-1]]), EXPONENT
    )
    return full, classify(gallery, SPECTRUM, query, distances[near], absent=absent)


def queries(count, width=20):
    return np.random.default_rng(5).normal(size=(count, width)).astype(np.float32)


def test_classes_that_samples_contain_wholly_change_nothing():
    for query in queries(10):
        full, ours = both([SAMPLE] * 60 + [3] * 20, query)
        assert len(ours.matches) < len(full.matches)
        for match, expected in zip(ours.matches, full.matches, strict=False):
            assert (match.label, match.distance) == (expected.label, expected.distance)
            assert match.confidence == pytest.approx(expected.confidence, rel=1e-12)


def test_classes_that_are_larger_than_their_samples_are_estimated():
    errors, without = [], []
    for query in queries(40):
        full, ours = both([200] * 40, query)
        errors.append(ours.matches[0].confidence - full.matches[0].confidence)
        share = sum(match.confidence for match in ours.matches)
        without.append(ours.matches[0].confidence / share - full.matches[0].confidence)
    assert np.abs(errors).max() < 0.02
    assert np.abs(errors).mean() < 0.2 * np.abs(without).mean()


def test_no_estimate_is_nearer_than_what_was_compared():
    sizes = [500] * 30
    vectors, codes = drawn(sizes)
    found = samples_of(vectors, codes, sizes).absent(queries(1)[0], SPECTRUM, {"class 3"}, 14.0, EXPONENT)
    assert found.shape == (29,)
    assert found.min() == 14


def test_a_query_that_equals_all_candidates_leaves_other_classes_their_distance():
    samples = ClassSamples(("a",), np.array([100]), np.ones((SAMPLE, 2), np.float32))
    assert samples.absent(np.zeros(2, np.float32), SPECTRUM, set(), 0.0, EXPONENT).tolist() == [2]
    assert samples.absent(np.zeros(2, np.float32), SPECTRUM, {"a"}, 0.0, EXPONENT).tolist() == []
