"""Classifiers by nearest neighbours: `nearest` and `vote`."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.matching.classification.classifier import Classifier, ClassScores, Query
from unbend.matching.selection import smallest

VOTERS: Final = 3
"""The number of voting neighbours: the fewest that can outvote one. Ties with the last of them vote too, so that no
vote depends on the order of the rows."""


def _score_by_nearest(query: Query) -> ClassScores:
    return ClassScores(query.nearest, query.nearest)


def _score_by_vote(query: Query) -> ClassScores:
    """Let neighbours vote by 1 / distance, and return the reciprocals of each class' votes as dissimilarities.

    The reciprocal is a distance: that of the nearest member if a class has a single voter. A class without voters
    gets the distance of its nearest member, which exceeds the distance of every voter.
    """
    labelled = np.where(query.gallery.codes >= 0, query.distances, np.inf)
    nearest = smallest(labelled, VOTERS)
    last = labelled[nearest[-1]] if len(nearest) else -np.inf
    voters = np.flatnonzero(labelled <= last)
    voters = voters[np.argsort(labelled[voters], kind="stable")]  # so that sums do not depend on the order of the rows
    with np.errstate(divide="ignore", over="ignore"):
        votes = np.bincount(query.gallery.codes[voters], 1.0 / labelled[voters], len(query.nearest))
        dissimilarities = np.where(votes > 0, 1.0 / votes, query.nearest)
    return ClassScores(dissimilarities, query.nearest)


NEAREST: Final = Classifier("nearest", _score_by_nearest)
"""The class of the nearest neighbour (Cover & Hart 1967)."""

VOTE: Final = Classifier("vote", _score_by_vote)
"""The nearest neighbours vote by 1 / distance (Dudani 1976)."""
