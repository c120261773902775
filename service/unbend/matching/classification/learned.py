"""What is learned from a gallery, once: kept as long as the gallery is."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from typing import TypeVar

from unbend.matching.gallery import Gallery

Learned = TypeVar("Learned")


def once_a_gallery(learn: Callable[[Gallery], Learned]) -> Callable[[Gallery], Learned]:
    """Return `learn` with a memory. It forgets with the gallery; who asks while it learns waits."""
    lock = threading.Lock()
    held: dict[int, Learned] = {}

    def of(gallery: Gallery) -> Learned:
        key = id(gallery)  # a gallery's arrays have no hash
        with lock:
            if key not in held:
                held[key] = learn(gallery)
                weakref.finalize(gallery, held.pop, key).atexit = False
            return held[key]

    return of
