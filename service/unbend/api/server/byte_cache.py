"""A cache of responses that are slow to make, such as pictures: in memory, and bounded by bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable


class ByteCache:
    """Keeps the most recently used responses, at most `capacity` bytes in total; used within one event loop."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._size = 0
        self._values: OrderedDict[Hashable, bytes] = OrderedDict()

    def get(self, key: Hashable) -> bytes | None:
        """Return the bytes of a key, if they are cached."""
        if key in self._values:
            self._values.move_to_end(key)
        return self._values.get(key)

    def put(self, key: Hashable, data: bytes) -> None:
        """Cache the bytes of a key, and evict the least recently used responses until the rest fits."""
        self._size += len(data) - len(self._values.pop(key, b""))
        self._values[key] = data
        while self._size > self._capacity:
            _, evicted = self._values.popitem(last=False)
            self._size -= len(evicted)
