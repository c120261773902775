"""Indices of many short runs of one long array."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Indices


def firsts_of(counts: Indices) -> Indices:
    """Return where each run begins, (n,), if runs of lengths `counts` (n,) lie one after the other."""
    return np.cumsum(counts) - counts


def spans(firsts: Indices, counts: Indices) -> Indices:
    """Return the indices of runs, run after run: `counts` (n,) of them from each of `firsts` (n,) on."""
    return np.repeat(firsts - firsts_of(counts), counts) + np.arange(int(counts.sum()))
