"""The vote of the nearest neighbours, each with the weight of its closeness."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.matching.classification.classifier import Classifier, Judgement
from unbend.matching.classification.query import Query
from unbend.matching.selection import smallest

VOTERS: Final = 3
"""The fewest that can outvote one. What is as far as the last of them votes, too: no vote hangs on a shape's place."""


def _judge(query: Query) -> Judgement:
    """Let neighbours vote by 1 / distance. A class without a vote has its nearest member's: less than any vote given.

    The reciprocal of the votes is then a distance: that of the nearest member where a class has a single voter.
    """
    labelled = np.where(query.gallery.codes >= 0, query.distances, np.inf)
    heard = smallest(labelled, VOTERS)
    last = labelled[heard[-1]] if len(heard) else -np.inf
    voters = np.flatnonzero(labelled <= last)
    voters = voters[np.argsort(labelled[voters], kind="stable")]  # so that sums are the same in any order of the rows
    with np.errstate(divide="ignore", over="ignore"):
        votes = np.bincount(query.gallery.codes[voters], 1.0 / labelled[voters], len(query.nearest))
        remoteness = np.where(votes > 0, 1.0 / votes, query.nearest)
    return Judgement(remoteness, query.nearest)


VOTE: Final = Classifier(
    name="vote",
    needs=1,
    reference=f"Dudani 1976: the {VOTERS} nearest neighbours vote by 1 / distance",
    judge=_judge,
)
