"""From distances to classes, with confidences."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats, Singles
from unbend.errors import ParameterError
from unbend.matching.classification.answer import Classification, ClassMatch
from unbend.matching.classification.calibration import calibration_of, confidences
from unbend.matching.classification.openset import is_known
from unbend.matching.classification.query import Query
from unbend.matching.classification.registry import DEFAULT_CLASSIFIER, get_classifier
from unbend.matching.gallery import Gallery
from unbend.matching.measures import VectorMeasure


def classify(
    gallery: Gallery,
    measure: VectorMeasure,
    query: Singles,
    distances: Floats,
    classifier: str = DEFAULT_CLASSIFIER,
) -> Classification:
    """Say which classes of `gallery` a query may belong to.

    Parameters
    ----------
    gallery : Gallery
        What is learned from it is kept with it: pass the same one again for another query.
    measure : VectorMeasure
    query : (d,) float32
    distances : (n,) float64
        From the query to each row of the gallery under `measure`. What is at no finite distance takes no part:
        set infinite what was removed, and the query itself where it is stored.
    classifier : str, default "nearest"

    Returns
    -------
    Classification
        All classes with a member. None at all where nothing has a label.

    Raises
    ------
    ParameterError
        If there is no such classifier, it needs more labels, or there are not as many distances as rows.
    """
    chosen = get_classifier(classifier)
    if distances.shape != (len(gallery),):
        raise ParameterError(f"distances of shape {distances.shape} for a gallery of {len(gallery)} rows")
    asked = Query(gallery, measure, query, distances)
    judgement = chosen.judge(asked)
    present = np.flatnonzero(judgement.remoteness < np.inf)
    if not len(present):
        return Classification([], None)
    calibration = calibration_of(measure.name)
    remoteness = judgement.remoteness[present]
    shares = confidences(remoteness, calibration.exponents[chosen.name])
    ordered = sorted(
        zip(
            remoteness.tolist(),
            (gallery.labels[code] for code in present),
            judgement.distances[present].tolist(),
            shares.tolist(),
            strict=True,
        )
    )
    matches = [ClassMatch(label, distance, share) for _, label, distance, share in ordered]
    return Classification(matches, is_known(asked, gallery.labels.index(matches[0].label), calibration.slack))
