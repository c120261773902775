"""Exact search: the distance from a query to every row of a gallery, in one pass over it at the speed of memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Literal

import numpy as np

from unbend.arrays import Floats, Singles
from unbend.errors import ParameterError
from unbend.jit import summing
from unbend.threads import check_threads, share_out

Norm = Literal["l1", "l2"]

_ALONE: Final = 1 << 22
"""Numbers that are read sooner than threads are started for them: about a millisecond's worth."""


def scan(query: Singles, gallery: Singles, norm: Norm = "l1", threads: int | None = None) -> Floats:
    """Return the distance from `query` to each row of `gallery`.

    A distance depends on nothing but the two vectors: not on the threads, the row's place or the other rows.
    It is exactly the same from either end, and 0 between equal vectors.

    Parameters
    ----------
    query : (d,) float32
        Finite numbers.
    gallery : (n, d) float32
        A row that holds an infinite number is infinitely far.
    norm : {"l1", "l2"}
        The sum of absolute differences, or the root of the sum of squared ones.
    threads : int, optional
        All cores by default. Few rows are left to the calling thread.

    Returns
    -------
    (n,) float64
        Summed in single precision; beyond its range, which for L2 are differences of 1e19, infinite.

    Raises
    ------
    ParameterError
        If the two do not fit together, the query is not finite, there is no such norm, or `threads` is below 1.
    """
    if norm not in _KERNELS:
        raise ParameterError(f"norm must be one of {', '.join(_KERNELS)}, not {norm!r}")
    if query.ndim != 1 or gallery.ndim != 2 or gallery.shape[1] != len(query):
        raise ParameterError(f"a query of shape {query.shape} has no distances from vectors of shape {gallery.shape}")
    workers = check_threads(threads)
    wanted, rows = _as_kernels_have_it(query), _as_kernels_have_it(gallery)
    if not np.isfinite(wanted).all():
        raise ParameterError("the query holds a number that is not finite, and so is at no distance from anything")
    kernel, distances = _KERNELS[norm], np.empty(len(rows))
    if workers == 1 or rows.size <= _ALONE:
        kernel(wanted, rows, distances)
    else:
        share_out(len(rows), workers, lambda part: kernel(wanted, rows[part], distances[part]))
    return distances


def _as_kernels_have_it(array: Singles) -> Singles:
    """Return a contiguous, read-only view: of one type, so that one piece of machine code makes all sums."""
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


@summing
def _l2(query: Singles, gallery: Singles, distances: Floats) -> None:
    for row in range(gallery.shape[0]):
        total = np.float32(0)
        for place in range(gallery.shape[1]):
            difference = query[place] - gallery[row, place]
            total += difference * difference
        distances[row] = np.sqrt(total)


_KERNELS: Final[Mapping[str, Callable[[Singles, Singles, Floats], None]]] = {"l1": _l1, "l2": _l2}
