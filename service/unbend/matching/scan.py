"""Exact search: distances from a query to every row of a gallery in one pass, limited only by memory bandwidth."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Singles
from unbend.errors import ParameterError
from unbend.jit import summing
from unbend.threads import check_threads, share_out

_SINGLE_THREAD_MAX: Final = 1 << 22
"""Largest number of values for which a single thread is faster, because threads take time to start.

One thread needs about a millisecond for so many values.
"""


def scan(query: Singles, gallery: Singles, threads: int | None = None) -> Floats:
    """Return the L1 distance, the sum of absolute differences, from `query` to each row of `gallery`.

    A distance depends only on the two vectors, not on the number of threads, the position of the row or the other rows.
    It is exactly symmetric, and 0 for equal vectors.

    Parameters
    ----------
    query : (d,) float32
        Finite values.
    gallery : (n, d) float32
        A row with an infinite value is at infinite distance.
    threads : int, optional
        All cores by default. For a small gallery, only the calling thread is used.

    Returns
    -------
    (n,) float64
        Summed in single precision; infinite beyond its range.

    Raises
    ------
    ParameterError
        If the shapes do not match, the query is not finite, or `threads` is below 1.
    """
    if query.ndim != 1 or gallery.ndim != 2 or gallery.shape[1] != len(query):
        raise ParameterError(f"a query of shape {query.shape} does not match a gallery of shape {gallery.shape}")
    workers = check_threads(threads)
    vector, rows = _kernel_view(query), _kernel_view(gallery)
    if not np.isfinite(vector).all():
        raise ParameterError("the query contains a value that is not finite")
    distances = np.empty(len(rows))
    if workers == 1 or rows.size <= _SINGLE_THREAD_MAX:
        _l1(vector, rows, distances)
    else:
        share_out(len(rows), workers, lambda part: _l1(vector, rows[part], distances[part]))
    return distances


def _kernel_view(array: Singles) -> Singles:
    """Return a contiguous, read-only view.

    Then all arrays have the same type, so that Numba compiles a single version of the kernel and all sums round alike.
    """
    view = np.ascontiguousarray(array, np.float32).view()
    view.flags.writeable = False
    return view


@summing
def _l1(query: Singles, gallery: Singles, distances: Floats) -> None:
    for row in range(gallery.shape[0]):
        total = np.float32(0)
        for place in range(gallery.shape[1]):
            total += abs(query[place] - gallery[row, place])
        distances[row] = total
