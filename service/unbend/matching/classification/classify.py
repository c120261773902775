"""Classification of a query, with confidences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unbend.arrays import Floats, Singles
from unbend.errors import ParameterError
from unbend.matching.classification.calibration import calibration_of, confidences, is_known
from unbend.matching.classification.classifier import Query
from unbend.matching.classification.registry import DEFAULT_CLASSIFIER, get_classifier
from unbend.matching.gallery import Gallery
from unbend.matching.measures import VectorMeasure


@dataclass(frozen=True)
class ClassMatch:
    """A class that a query may belong to."""

    label: str
    distance: float
    """Distance from the query to the class, by the definition of the classifier, such as that to the nearest member."""
    confidence: float
    """Probability, 0 to 1, that this is the query's class, provided that the library contains the query's class."""


@dataclass(frozen=True)
class Classification:
    """All classes, best first, and whether the query is near enough to the best class."""

    matches: list[ClassMatch]
    """Equally good classes are in the order of their labels."""
    known: bool | None
    """False if the query is too far from the best class to belong to it. None if that class has a single member."""


def classify(
    gallery: Gallery,
    measure: VectorMeasure,
    query: Singles,
    distances: Floats,
    classifier: str = DEFAULT_CLASSIFIER,
    absent: Floats | None = None,
) -> Classification:
    """Sort the classes of `gallery` by the probability that `query` belongs to them.

    Parameters
    ----------
    gallery : Gallery
        Learned models are cached per gallery object, so pass the same object for further queries.
    measure : VectorMeasure
    query : (d,) float32
    distances : (n,) float64
        Distances from the query to each row of the gallery under `measure`. Rows at infinite distance are excluded. Use
        this for removed rows, and for the row of the query itself if it is stored.
    classifier : str, default "nearest"
    absent : (c,) float64, optional
        Distances of classes without members in the gallery, which lower the confidences of the others.

    Returns
    -------
    Classification
        All classes that have a member; none if no row has a label.

    Raises
    ------
    ParameterError
        If there is no such classifier, the classifier needs more labels, or there is not one distance for each row.
    """
    chosen = get_classifier(classifier)
    if distances.shape != (len(gallery),):
        raise ParameterError(f"distances of shape {distances.shape} for a gallery of {len(gallery)} rows")
    checked = Query(gallery, measure, query, distances)
    scores = chosen.score(checked)
    present = np.flatnonzero(scores.dissimilarities < np.inf)
    if not len(present):
        return Classification([], None)
    calibration = calibration_of(measure.name)
    dissimilarities = scores.dissimilarities[present]
    every = dissimilarities if absent is None else np.concatenate([dissimilarities, absent])
    shares = confidences(every, calibration.exponents[chosen.name])[: len(present)]
    ordered = sorted(
        zip(
            dissimilarities.tolist(),
            (gallery.labels[code] for code in present),
            scores.distances[present].tolist(),
            shares.tolist(),
            strict=True,
        )
    )
    matches = [ClassMatch(label, distance, confidence) for _, label, distance, confidence in ordered]
    return Classification(matches, is_known(checked, gallery.labels.index(matches[0].label), calibration.slack))
