"""Shapes to compare a query with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from unbend.arrays import Codes, Singles

UNLABELLED: Final = -1


@dataclass(frozen=True)
class Gallery:
    """Vectors, one row a shape, and their classes."""

    vectors: Singles
    """(n, d)."""
    codes: Codes
    """Place in `labels` of each row's class, (n,); UNLABELLED where it has none."""
    labels: tuple[str, ...]
    """The classes. One may have no members left."""

    @classmethod
    def of(cls, vectors: Singles, labels: Sequence[str | None]) -> Self:
        """Make one from a label, or None, for each row of `vectors`."""
        names = tuple(dict.fromkeys(label for label in labels if label is not None))
        places = {name: place for place, name in enumerate(names)}
        codes = np.array([UNLABELLED if label is None else places[label] for label in labels], np.int32)
        return cls(np.asarray(vectors, np.float32), codes, names)

    def __len__(self) -> int:
        return len(self.codes)

    def label(self, row: int) -> str | None:
        """Return the class of a row."""
        code = int(self.codes[row])
        return None if code == UNLABELLED else self.labels[code]
