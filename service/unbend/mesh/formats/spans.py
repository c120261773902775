"""Indices of many short runs of one long array."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Indices


def firsts_of(counts: Indices) -> Indices:
    """Return the start of each run, (n,), for consecutive runs of lengths `counts` (n,)."""
    return np.cumsum(counts) - counts


def spans(firsts: Indices, counts: Indices) -> Indices:
    """Return the indices of all runs, run after run. Each run has `counts` (n,) indices and starts at `firsts` (n,)."""
    return np.repeat(firsts - firsts_of(counts), counts) + np.arange(int(counts.sum()))
