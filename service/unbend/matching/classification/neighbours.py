"""Classifiers by nearest neighbours: `nearest` and `vote`."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.matching.classification.classifier import Classifier, ClassScores, Query
from unbend.matching.selection import smallest

VOTERS: Final = 3
"""Number of voting neighbours. Of three, two can outvote the other.

Neighbours at the distance of the last voter also vote, so that results do not depend on the order of the rows.
"""


def _score_by_nearest(query: Query) -> ClassScores:
    return ClassScores(query.nearest, query.nearest)


def _score_by_vote(query: Query) -> ClassScores:
    """Let neighbours vote with the weight 1 / distance. Dissimilarities are the reciprocals of each class' votes.

    The reciprocal has the unit of a distance. If a class has a single voter, it is the distance of that voter. A class
    without voters gets the distance of its nearest member, which is larger than that of every voter.
    """
    labelled = np.where(query.gallery.codes >= 0, query.distances, np.inf)
    nearest = smallest(labelled, VOTERS)
    last = labelled[nearest[-1]] if len(nearest) else -np.inf
    voters = np.flatnonzero(labelled <= last)
    voters = voters[np.argsort(labelled[voters], kind="stable")]  # so that sums do not depend on the order of rows
    with np.errstate(divide="ignore", over="ignore"):
        votes = np.bincount(query.gallery.codes[voters], 1.0 / labelled[voters], len(query.nearest))
        dissimilarities = np.where(votes > 0, 1.0 / votes, query.nearest)
    return ClassScores(dissimilarities, query.nearest)


NEAREST: Final = Classifier("nearest", _score_by_nearest)
"""The class of the nearest neighbour (Cover & Hart 1967)."""

VOTE: Final = Classifier("vote", _score_by_vote)
"""The class with the most votes, where the nearest neighbours vote with weight 1 / distance (Dudani 1976)."""
