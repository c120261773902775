"""How well the shapes of a library find their own classes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

from unbend.brief import brief
from unbend.matching.evaluate import Evaluation, EvaluationSummary
from unbend.matching.evaluate.summary import facts_of


@dataclass(frozen=True)
class EvaluationResult(EvaluationSummary):
    """The results of ranking the other shapes for each labelled shape of a library."""

    measure: str = field(kw_only=True)

    def __repr__(self) -> str:
        return brief(self, self.measure, *facts_of(self))

    @classmethod
    def of(cls, measure: str, evaluation: Evaluation) -> Self:
        """Return the results of an evaluation by a measure."""
        return cls(**vars(evaluation.summary), measure=measure)
