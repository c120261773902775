"""The nearest of a search by vectors, compared anew by a measure that needs both signatures whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.matching.measures.protocol import PairMeasure
from unbend.matching.measures.registry import check_comparable
from unbend.signature.signature import Signature
from unbend.threads import check_threads, share_out

SHORTLIST: Final = 5
"""Candidates by default. In the order of a pair measure alone, longer lists lost more where the measure of the search
was right than they won where it was not (benchmarks/rerank.py, "length of the short list")."""


def rerank(
    query: Signature, candidates: Sequence[Signature], measure: PairMeasure, threads: int | None = None
) -> Floats:
    """Return the distance of `measure` from `query` to each of `candidates`.

    Parameters
    ----------
    query : Signature
    candidates : sequence of c Signature
        The nearest by a `VectorMeasure`, say; `SHORTLIST` of them by default.
    measure : PairMeasure
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    (c,) float64
        In the order of the candidates; `smallest` tells the new one.

    Raises
    ------
    ParameterError
        If `threads` is below 1, or a candidate was made with other parameters than the query, or by another version.
    """
    check_threads(threads)
    for candidate in candidates:
        check_comparable(query, candidate)
    distances = np.empty(len(candidates))

    def fill(part: slice) -> None:
        for row in range(part.start, part.stop):
            distances[row] = measure.distance(query, candidates[row])

    if len(candidates) > 0:
        share_out(len(candidates), threads, fill)
    return distances
