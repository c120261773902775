"""Reranking: comparing the nearest shapes of a vector search again, by a measure of whole signatures."""

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
"""The default number of candidates. The pair measure alone decides their order, and with longer lists it spoils more
correct results than it corrects wrong ones (benchmarks/retrieval/rerank.py, "length of the short list")."""


def rerank(
    query: Signature, candidates: Sequence[Signature], measure: PairMeasure, threads: int | None = None
) -> Floats:
    """Return the distance under `measure` from `query` to each of `candidates`.

    Parameters
    ----------
    query : Signature
    candidates : sequence of c Signature
        For example the nearest shapes under a `VectorMeasure`.
    measure : PairMeasure
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    (c,) float64
        In the order of the candidates.

    Raises
    ------
    ParameterError
        If `threads` is below 1, or the parameters or the version of a candidate differ from the query's.
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
