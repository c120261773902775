"""The nearest neighbour: a class is as far as its nearest member."""

from __future__ import annotations

from typing import Final

from unbend.matching.classification.classifier import Classifier, Judgement
from unbend.matching.classification.query import Query


def _judge(query: Query) -> Judgement:
    return Judgement(query.nearest, query.nearest)


NEAREST: Final = Classifier(
    name="nearest",
    needs=1,
    reference="Cover & Hart 1967: the class of the nearest neighbour",
    judge=_judge,
)
