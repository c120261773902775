"""Pieces of arrays: many short runs of one long array, taken at once."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Indices


def firsts_of(counts: Indices) -> Indices:
    """Return where each run begins, (n,), when runs of these lengths (n,) lie one after the other."""
    return np.cumsum(counts) - counts


def spans(firsts: Indices, counts: Indices) -> Indices:
    """Return the indices of runs, one run after the other: `counts` (n,) of them from each of `firsts` (n,) on."""
    return np.repeat(firsts - firsts_of(counts), counts) + np.arange(int(counts.sum()))
