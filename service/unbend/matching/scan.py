"""Exact search: the distance from a query to every row of a gallery, in one pass over it."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats, Singles


def scan(query: Singles, gallery: Singles) -> Floats:
    """Return the L1 distance from `query` (d,) to each row of `gallery` (n, d), as (n,)."""
    return np.asarray(np.abs(gallery - query).sum(axis=1, dtype=np.float64))
