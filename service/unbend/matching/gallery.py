"""A gallery: labelled vectors that a query is compared with, and a cache of values computed once per gallery."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Self, TypeVar

import numpy as np

from unbend.arrays import Codes, Singles

UNLABELLED: Final = -1

Value = TypeVar("Value")


@dataclass(frozen=True)
class Gallery:
    """Vectors, one row per shape, and their classes."""

    vectors: Singles
    """(n, d)."""
    codes: Codes
    """Index into `labels` of each row's class, (n,), UNLABELLED for rows without a class."""
    labels: tuple[str, ...]
    """The classes. A class may have no members."""

    @classmethod
    def of(cls, vectors: Singles, labels: Sequence[str | None]) -> Self:
        """Make a gallery. `labels` has a class, or None, for each row of `vectors`."""
        names = tuple(dict.fromkeys(label for label in labels if label is not None))
        code_of = {name: code for code, name in enumerate(names)}
        codes = np.array([UNLABELLED if label is None else code_of[label] for label in labels], np.int32)
        return cls(np.asarray(vectors, np.float32), codes, names)

    def __len__(self) -> int:
        return len(self.codes)

    def label(self, row: int) -> str | None:
        """Return the class of a row, None if it has none."""
        code = int(self.codes[row])
        return None if code == UNLABELLED else self.labels[code]


def cached_per_gallery(compute: Callable[[Gallery], Value]) -> Callable[[Gallery], Value]:
    """Cache the result of `compute` for each gallery until the gallery is garbage collected.

    Only one thread computes at a time; other threads wait for it.
    """
    lock = threading.Lock()
    cache: dict[int, Value] = {}

    def cached(gallery: Gallery) -> Value:
        key = id(gallery)  # a gallery's arrays have no hash
        with lock:
            if key not in cache:
                cache[key] = compute(gallery)
                weakref.finalize(gallery, cache.pop, key).atexit = False
            return cache[key]

    return cached
